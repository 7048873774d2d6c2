"""Transfer functions against scipy; impulse responses, alone and side by side."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import signal

from examples.paper.tables import transfer_functions
from hframe_post.arrays import Array, Complex
from hframe_post.errors import ArgumentError
from hframe_post.model.impulse_response import ImpulseResponse
from hframe_post.model.plant import Response
from hframe_post.model.transfer_function import TransferFunction
from hframe_post.prediction.predict import Nozzle
from hframe_post.printer.settings import Printer
from tests.paths import walk
from tests.plants import Filter

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
    response = ImpulseResponse.from_transfer_function(G, float(round(G.dc_gain)))
    scale = 140.0 if G.dc_gain < 0.5 else 1.0  # mm of lever arm
    assert np.abs(Filter(response).run(u) - by_scipy(G, u)).max() * scale < 1e-4  # mm, of random


def test_a_response_that_does_not_end_is_refused() -> None:
    nothing, poles = np.zeros(0, complex), np.array([0.999 + 0j])
    with pytest.raises(ValueError, match="still rings after 4000 ms"):
        ImpulseResponse.from_transfer_function(TransferFunction(nothing, poles, 0.001), 1.0)


@given(st.integers(0, 2**32 - 1))
def test_impulse_and_frequency_response_are_one(seed: int) -> None:
    """However many real roots and pairs there are, and wherever they lie."""
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


@pytest.mark.parametrize("racks", [True, False])
@pytest.mark.parametrize("every", [1, 4, 7])
def test_a_piece_of_a_command_moves_the_nozzle_as_all_of_it(
    paper: Printer, every: int, racks: bool
) -> None:
    """However rough the command is. Without frequencies that the half rate lacks, it is exact."""
    plant = paper.plant if racks else paper.plant.decoupled()
    origin, nozzle = np.array([200.0, 80.0]), Nozzle(plant)
    rough = list(walk(np.random.default_rng(1), 2000).T)
    smooth = [np.convolve(each, np.hanning(48) / np.hanning(48).sum(), "same") for each in rough]
    begin, n = 1400, 333

    def places(command: Array, begin: int, stop: int, every: int) -> Array:
        path = np.zeros((len(command), 4))
        cut = begin, begin, stop, every, every
        _, _, found, *_ = nozzle.judged(path, False, command[None], *cut)
        return np.asarray(found[0])

    for way in (rough, smooth):
        command = origin + np.column_stack(way)
        whole = places(command, 0, len(command), 1)
        first, last = begin - nozzle.past, begin + n + nozzle.ahead
        piece = places(command[first:last], nozzle.past, nozzle.past + n, every)
        np.testing.assert_allclose(piece, whole[begin:][:n:every], rtol=0.0, atol=2e-6)  # mm
    exact = Response(plant, origin).run(command)[begin : begin + n : every]
    np.testing.assert_allclose(piece, exact, rtol=0.0, atol=1e-5)  # mm


OMEGA = np.linspace(0.0, 3.0, 100)


@pytest.mark.parametrize("lead", [0, 7])
def test_a_lag_is_how_late_the_nozzle_is_at_a_constant_speed(lead: int) -> None:
    G = ImpulseResponse(np.random.default_rng(1).normal(size=20), lead, lag=2.3)

    h, late = G.impulse(40), np.arange(40) - G.ahead
    of_impulse = np.exp(-1j * OMEGA[:, None] * late) @ h
    assert np.abs(of_impulse - G.response(OMEGA)).max() < 1e-10  # of 1
    assert h.sum() == pytest.approx(1.0, abs=1e-12)
    assert h @ late == pytest.approx(2.3, abs=1e-10)  # samples
    assert ImpulseResponse(np.zeros(1), 0, lag=2.3).impulse(3) == pytest.approx([-1.3, 2.3, 0.0])


@pytest.mark.parametrize(
    "bad",
    [{"deviation": []}, {"deviation": [0.0, np.inf]}, {"lead": 2}, {"rest": np.nan},
     {"drift": 1.0}, {"unknown": np.zeros((2, 2))}],
)  # fmt: skip
def test_an_impossible_response_is_refused(bad: dict[str, Any]) -> None:
    with pytest.raises(ArgumentError, match=next(iter(bad))):
        ImpulseResponse(**{"deviation": np.array([0.0, 1.0]), "lead": 0, **bad})
