"""Transfer functions against scipy."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import signal

from examples.paper.tables import transfer_functions
from hframe_post.arrays import Array, Complex
from hframe_post.model.impulse_response import ImpulseResponse
from hframe_post.model.transfer_function import TransferFunction
from tests.plants import Filter, as_response

ALL = pytest.mark.parametrize("G", [*transfer_functions().values()], ids=[*transfer_functions()])


def by_scipy(G: TransferFunction, u: Array) -> Array:
    """scipy's sections count a missing zero as one at the origin: they lack the delay."""
    delay = len(G.poles) - len(G.zeros)
    ahead = signal.sosfilt(signal.zpk2sos(G.zeros, G.poles, G.gain), u)
    return np.concatenate([np.zeros(delay), np.asarray(ahead)])[: len(u)]


@pytest.mark.paper
@ALL
def test_eq_4_impulse_response(G: TransferFunction) -> None:
    pulse = np.zeros(600)
    pulse[0] = 1.0
    np.testing.assert_allclose(G.impulse(600), by_scipy(G, pulse), atol=1e-9)


@pytest.mark.paper
@ALL
def test_the_response_of_a_transfer_function_moves_the_nozzle_alike(G: TransferFunction) -> None:
    """It ends where its rest is below 0.01 µm of a motion at 10 000 mm/s²."""
    u = np.cumsum(np.cumsum(np.random.default_rng(0).uniform(-0.01, 0.01, 4000)))
    response = as_response(G, float(round(G.dc_gain)))
    scale = 140.0 if G.dc_gain < 0.5 else 1.0  # mm of lever arm
    assert np.abs(Filter(response).run(u) - by_scipy(G, u)).max() * scale < 1e-4  # mm, of random


def test_a_response_that_does_not_end_is_refused() -> None:
    nothing, poles = np.zeros(0, complex), np.array([0.999 + 0j])
    with pytest.raises(ValueError, match="still rings after 4000 ms"):
        ImpulseResponse.from_transfer_function(TransferFunction(nothing, poles, 0.001), 1.0)


@ALL
def test_frequency_response(G: TransferFunction) -> None:
    omega = np.linspace(0.001, 3.0, 200)
    _, expected = signal.freqz_zpk(G.zeros, G.poles, G.gain, worN=omega)
    np.testing.assert_allclose(G.response(omega), expected, rtol=1e-9)


@given(st.integers(0, 2**32 - 1))
def test_any_real_roots_and_pairs_make_sections(seed: int) -> None:
    """However many of either, and wherever they lie: the state space has the same response."""
    rng = np.random.default_rng(seed)

    def roots(n: int, radius: float) -> Complex:
        pairs = int(rng.integers(0, n // 2 + 1))
        upper = radius * rng.random(pairs) * np.exp(1j * rng.uniform(0.05, 3.0, pairs))
        real = rng.uniform(-radius, radius, n - 2 * pairs)
        return np.concatenate([upper, upper.conj(), real])

    order = int(rng.integers(1, 9))
    G = TransferFunction(roots(int(rng.integers(0, order + 1)), 1.5), roots(order, 0.9), 1.0)
    h = G.impulse(2048)
    omega = np.linspace(0.1, 3.0, 7)
    response = np.exp(-1j * np.outer(omega, np.arange(2048))) @ h
    np.testing.assert_allclose(response, G.response(omega), rtol=1e-6, atol=1e-6)
