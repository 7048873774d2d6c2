"""The choice of a model for linear and nonlinear printers."""

from __future__ import annotations

import numpy as np
import pytest

from hframe_post.arrays import TS, Array, Complex
from hframe_post.errors import IdentificationError
from hframe_post.identification.fitting.fit import fit
from hframe_post.identification.responses.frequency_response import (
    Distortion,
    FrequencyResponse,
    average,
)
from hframe_post.model.transfer_function import TransferFunction
from tests.plants import all_of_them, at, at_rest
from tests.simulator import Axis, Machine, Mode

HZ = np.arange(3.0, 100.01, 0.25)
BAND = (3.0, 100.0)
GAIN, PEAK_HZ = 1.02, 40.0


def measured(hz: float, damping: float) -> Complex:
    axis = Axis((Mode(hz, damping),), delay=0.001)
    return Machine(axis, axis).exact().Gxx.response(2.0 * np.pi * HZ * TS)


@pytest.fixture(scope="module")
def bent() -> tuple[FrequencyResponse, Distortion]:
    """A belt that gets softer at resonance: a peak that leans over."""
    right = measured(PEAK_HZ, 0.06)
    leaning = 0.5 * (right + measured(0.96 * PEAK_HZ, 0.045))
    one = np.ones(len(HZ))
    response = FrequencyResponse(HZ, GAIN * leaning, 0.9999 * one, one, 50.0)
    return response, Distortion(HZ, (leaning - right) / leaning, 0.0)


def test_a_nonlinearity_is_not_fitted_with_modes(
    bent: tuple[FrequencyResponse, Distortion],
) -> None:
    response, distortion = bent
    found = fit([response], response, False, BAND, distortion=distortion)
    assert found.order == 2
    (hz, _), *_ = found.modes
    assert hz == pytest.approx(PEAK_HZ, rel=0.03)
    assert found.gain == pytest.approx(GAIN, abs=0.005)
    assert found.residual_over_noise < 1.5  # the harmonics account for the residual


def test_the_same_response_of_a_linear_printer_is_two_modes(
    bent: tuple[FrequencyResponse, Distortion],
) -> None:
    response, _ = bent
    found = fit([response], response, False, BAND)
    assert found.order == 4
    assert found.residual < 0.01


def hardening(hz: Array, mode: Mode, share: float) -> Complex:
    """Return the response (k,) of a belt that is ``share`` stiffer per squared stretch."""
    H, found = 1.0 + 0.0j, []
    for r in hz / mode.hz:
        for _ in range(60):  # the answer sets the stiffness, which sets the answer
            pull = 1.0 + share * abs(H) ** 2 / max(r, 1.0) ** 4 + 2j * mode.damping * r
            H = 0.5 * H + 0.5 * pull / (pull - r * r)
        found.append(H)
    return np.array(found)


@pytest.mark.slow
def test_poles_that_cancel_one_another_do_not_explain_a_hardening_belt() -> None:
    """Compensation by such a model made prints worse than none."""
    hz = HZ[::2]
    H = hardening(hz, Mode(36.0, 0.08), 5e-4) * np.exp(-2j * np.pi * hz * 0.00235)
    rng, one, noise = np.random.default_rng(5), np.ones(len(hz)), 0.001
    runs = []
    for _ in range(2):
        real, imaginary = rng.normal(size=(2, len(hz))) / np.sqrt(2.0)
        noisy = H * (1.0 + noise * (real + 1j * imaginary))
        runs.append(FrequencyResponse(hz, noisy, one / (1.0 + noise**2), one))
    found = fit(runs, average(runs), False, BAND)
    assert np.abs(found.model.coefficients).sum() < 10.0 * found.gain
    assert found.residual < 0.02


@pytest.mark.parametrize(("gain", "found_gain"), [(1.005, 1.0044), (1.002, 1.0)])
def test_a_sensor_is_exact_unless_the_recordings_clearly_deny_it(
    gain: float, found_gain: float
) -> None:
    """They deny it by 8 standard deviations, and by 2.6."""
    rng, one, noise = np.random.default_rng(7), np.ones(len(HZ)), 0.02
    runs = []
    for _ in range(2):
        real, imaginary = rng.normal(size=(2, len(HZ))) / np.sqrt(2.0)
        noisy = gain * measured(PEAK_HZ, 0.06) * (1.0 + noise * (real + 1j * imaginary))
        runs.append(FrequencyResponse(HZ, noisy, one / (1.0 + noise**2), one))
    found = fit(runs, average(runs), False, BAND)
    assert found.gain == pytest.approx(found_gain, abs=5e-4)


@pytest.mark.slow
@pytest.mark.parametrize("k", range(12))
def test_noisy_responses_of_known_plants_are_recovered(k: int) -> None:
    """Also of the paper's plant, whose Gyy and racking have poles above and below the band."""
    G = all_of_them()[k]
    rng = np.random.default_rng(5)
    runs = []
    for _ in range(3):
        real, imaginary = rng.normal(size=(2, len(HZ))) / np.sqrt(2.0)
        H = at(G, HZ) * (1.0 + 0.005 * (real + 1j * imaginary))
        one = np.ones(len(HZ))
        runs.append(FrequencyResponse(HZ, H, one / (1.0 + 0.005**2), one))
    found = fit(runs, average(runs), at_rest(G) == 0.0, BAND)
    hz = np.arange(5.0, 80.0, 0.1)
    true = at(G, hz)
    assert np.linalg.norm(found.response(hz) - true) / np.linalg.norm(true) < 0.005
    assert found.G.dc_gain == pytest.approx(at_rest(G), abs=1e-9)
    assert isinstance(found.G, TransferFunction)
    assert np.abs(found.G.poles).max() < 1.0


def test_measurements_that_cannot_be_fitted_are_refused() -> None:
    one = np.ones(len(HZ))
    good = FrequencyResponse(HZ, measured(PEAK_HZ, 0.06), 0.9999 * one, one, 50.0)
    with pytest.raises(IdentificationError, match="too few"):
        fit([good], good, False, (3.0, 5.0))
    for H, cause in ((good.H * np.nan, "finite"), (good.H * 0.0, "zero")):
        bad = FrequencyResponse(HZ, H, good.coherence, good.power)
        with pytest.raises(IdentificationError, match=cause):
            fit([bad], bad, False, BAND)


@pytest.mark.slow
def test_a_printer_that_does_not_follow_its_command_is_refused() -> None:
    one = np.ones(len(HZ))
    backwards = FrequencyResponse(HZ, -measured(PEAK_HZ, 0.06), 0.9999 * one, one, 50.0)
    with pytest.raises(IdentificationError, match="follows the command"):
        fit([backwards], backwards, False, BAND)
