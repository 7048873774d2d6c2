"""The responses of axes and of racking, from our own sweeps."""

from __future__ import annotations

import numpy as np
import pytest

from hframe_post.arrays import TS, Complex
from hframe_post.errors import IdentificationError
from hframe_post.identification.estimation.axes import Fit, Swept, fit_racking, fit_swept
from hframe_post.identification.responses.frequency_response import FrequencyResponse
from tests.identification.modal_tools import HZ
from tests.plants import all_of_them, at, at_rest
from tests.simulator import Axis, Machine, Mode

GAIN, PEAK_HZ = 1.02, 40.0


def exact(hz: float, damping: float, delay: float = 0.001) -> Complex:
    axis = Axis((Mode(hz, damping),), delay=delay)
    return Machine(axis, axis).exact().Gxx.response(2.0 * np.pi * HZ * TS)


def seen(H: Complex, noise: float = 0.01, seed: int = 5) -> FrequencyResponse:
    real, imaginary = np.random.default_rng(seed).normal(size=(2, len(HZ))) / np.sqrt(2.0)
    one = np.ones(len(HZ))
    measured = H * (1.0 + noise * (real + 1j * imaginary))
    return FrequencyResponse(HZ, measured, one / (1.0 + noise**2), one)


def fitted(measured: FrequencyResponse, bounds: tuple[float, float] = (0.0, 0.0)) -> Fit:
    return fit_swept({"Gxx": Swept(measured, bounds)})["Gxx"]


def off(found: Fit, true: Complex) -> float:
    """Return the relative error of the response, weighted as it moves a print."""
    error = found.G.response(2e-3 * np.pi * HZ) - true
    return float(np.linalg.norm(error / HZ) / np.linalg.norm(true / HZ))


@pytest.mark.slow
def test_x_and_y_are_taken_to_have_the_same_delay() -> None:
    """Their recordings began 0.1 ms late and 0.1 ms early, which nobody knows."""
    late, bounds = 1e-4, (-1.6e-4, 1.6e-4)
    true = {"Gxx": exact(32.0, 0.06), "Gyy": exact(45.0, 0.1)}
    turned = np.exp(-2j * np.pi * HZ * late)
    recorded = {"Gxx": true["Gxx"] * turned, "Gyy": true["Gyy"] / turned}
    found = fit_swept({name: Swept(seen(H), bounds) for name, H in recorded.items()})
    x, y = found["Gxx"], found["Gyy"]
    assert x.recording_delay - y.recording_delay == pytest.approx(2.0 * late, abs=2e-5)
    assert x.lag == pytest.approx(1e-3 + 0.12 / (2.0 * np.pi * 32.0), abs=8e-5)


@pytest.mark.slow
@pytest.mark.parametrize("k", range(12))
def test_noisy_responses_of_known_plants_are_recovered(k: int) -> None:
    """Also of the paper's plant, whose Gyy and racking have poles above and below the band."""
    G = all_of_them()[k]
    measured = seen(at(G, HZ), 0.003)
    found = (
        fitted(measured)
        if at_rest(G)
        else fit_racking(measured, fitted(seen(exact(PEAK_HZ, 0.06))), 1.0, True)
    )
    assert off(found, at(G, HZ)) < 0.01
    assert found.G.dc_gain == pytest.approx(at_rest(G), abs=1e-9)


def test_measurements_that_are_none_are_refused() -> None:
    good = seen(exact(PEAK_HZ, 0.06))
    with pytest.raises(IdentificationError, match="too few"):
        fitted(good.within((3.0, 5.0)))
    for H, cause in ((good.H * np.nan, "finite"), (good.H * 0.0, "zero")):
        with pytest.raises(IdentificationError, match=cause):
            fitted(FrequencyResponse(HZ, H, good.coherence, good.power))


def test_a_printer_that_does_not_follow_its_command_is_refused() -> None:
    with pytest.raises(IdentificationError, match="follow the command"):
        fitted(seen(-exact(PEAK_HZ, 0.06)))
