"""The fit against the transfer functions whose responses it is given."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hframe_post.arrays import Array
from hframe_post.errors import IdentificationError
from hframe_post.identification.fitting.kautz import denominator, transfer_function
from hframe_post.identification.fitting.rational import RADIUS, Rational, fit
from hframe_post.identification.responses.frequency_response import FrequencyResponse, estimate
from hframe_post.model.plant import LiftedFilter
from hframe_post.model.transfer_function import TransferFunction
from tests.conftest import few
from tests.plants import all_of_them, at, at_rest, resonant, sweep

HZ = np.arange(1.0, 100.01, 0.25)
BAND = (1.0, 100.0)
NAMES = [f"{who}-{what}" for who in ("paper", "1", "2", "3") for what in ("Gxx", "Gyy", "Gxtheta")]
ALL = pytest.mark.parametrize("G", all_of_them(), ids=NAMES)
SOME = pytest.mark.parametrize("G", few(all_of_them(), 6), ids=NAMES)
NARROW = (-2e-4, 2e-4)


def measured(G: TransferFunction, noise: float = 0.0, delay: float = 0.0) -> FrequencyResponse:
    real, imaginary = np.random.default_rng(5).normal(size=(2, len(HZ))) / np.sqrt(2.0)
    H = at(G, HZ, delay) * (1.0 + noise * (real + 1j * imaginary))
    return FrequencyResponse(HZ, H, np.full(len(HZ), 1.0 / (1.0 + noise**2)), np.ones(len(HZ)))


def error(found: Rational, G: TransferFunction, delay: float = 0.0) -> float:
    hz = np.arange(5.0, 80.0, 0.1)
    true = at(G, hz, delay)
    return float(np.linalg.norm(found.response(hz) - true) / np.linalg.norm(true))


@ALL
@pytest.mark.parametrize(
    "bounds", [NARROW, pytest.param((-3e-3, 3e-3), marks=pytest.mark.slow)], ids=["narrow", "wide"]
)
def test_exact_responses_give_the_function(
    G: TransferFunction, bounds: tuple[float, float]
) -> None:
    found = fit(measured(G), None, at_rest(G), BAND, bounds)
    assert error(found, G) < 1e-4
    assert abs(found.delay) < 5e-5
    assert found.G.order == G.order


@pytest.mark.slow
@ALL
def test_noisy_responses_give_it_nearly(G: TransferFunction) -> None:
    found = fit(measured(G, 0.01), None, at_rest(G), BAND, NARROW)
    assert error(found, G) < 0.003


@ALL
def test_what_is_found_is_stable_and_exact_at_rest(G: TransferFunction) -> None:
    found = fit(measured(G, 0.03), G.order, at_rest(G), BAND, NARROW).G
    assert np.abs(found.poles).max() <= RADIUS
    assert found.dc_gain == pytest.approx(at_rest(G), abs=1e-9)
    assert len(found.zeros) < len(found.poles) + (at_rest(G) == 0.0)
    if at_rest(G) == 0.0:
        assert 1.0 in found.zeros


@SOME
def test_a_noisy_sweep_gives_it(G: TransferFunction) -> None:
    u = sweep()
    sd = 3.0 * np.sqrt(500.0) * (1.0 if at_rest(G) else np.sqrt(2.0) / 300.0)
    noise = sd * np.random.default_rng(7).normal(size=len(u))
    response = estimate(u, LiftedFilter(G).run(u) + noise)
    found = fit(response, None, at_rest(G), (3.0, 115.0), NARROW)
    assert error(found, G) < 0.003


@pytest.mark.parametrize("delay", [-1.3e-4, 1e-4, 1.8e-3])
def test_a_delay_within_the_bounds_is_found(delay: float) -> None:
    G = all_of_them()[0]
    found = fit(measured(G, delay=delay), None, 1.0, BAND, (-2e-4, 2e-3))
    assert found.delay == pytest.approx(delay, abs=5e-5)
    assert error(found, G, delay) < 1e-4


def test_what_cannot_be_fitted_is_refused() -> None:
    G = resonant(40.0, 0.1)
    good = measured(G)
    with pytest.raises(IdentificationError, match="too few"):
        fit(good, 8, 1.0, (1.0, 3.0))
    with pytest.raises(IdentificationError, match="order 0"):
        fit(good, 0, 1.0, BAND)
    for H, cause in ((good.H * np.nan, "finite"), (good.H * 0.0, "zero")):
        with pytest.raises(IdentificationError, match=cause):
            fit(FrequencyResponse(good.hz, H, good.coherence, good.power), 2, 1.0, BAND)
    with pytest.raises(ValueError, match="ascend"):
        fit(good, 2, 1.0, BAND, (1.0, 0.0))


@settings(max_examples=50)
@given(
    st.lists(st.tuples(st.floats(0.1, 0.998), st.floats(0.01, 3.1)), min_size=1, max_size=4),
    st.lists(st.floats(-0.9, 0.998), max_size=3),
    st.integers(0, 2**32 - 1),
    st.booleans(),
)
def test_roots_of_a_sum_of_basis_functions(
    pairs: list[tuple[float, float]], real: list[float], seed: int, direct: bool
) -> None:
    upper = np.array([r * np.exp(1j * angle) for r, angle in pairs])
    den = denominator(np.concatenate([upper, upper.conj(), real]), RADIUS)
    z = np.exp(1j * np.linspace(0.01, 3.0, 50))
    basis, one = den.basis(z, direct), den.basis(np.ones(1, complex), direct)[0].real
    c: Array = np.random.default_rng(seed).normal(size=(basis.shape[1],))
    c[1] += (1.0 - c @ one) / one[1]
    G = transfer_function(den, c, 1.0, z)
    wanted = basis @ c
    scale = np.abs(wanted).max()
    np.testing.assert_allclose(G.response(np.angle(z)), wanted, rtol=1e-3, atol=1e-3 * scale)
