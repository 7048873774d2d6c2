"""A sum of modes that describes a response."""

import numpy as np
import pytest

from hframe_post.arrays import TS, Complex
from hframe_post.identification.estimation.frequency_response import FrequencyResponse
from hframe_post.identification.estimation.modes import described
from hframe_post.identification.estimation.regression import Mode
from tests.identification.modal_tools import HZ, TWO, continuous

ROUGH = [Mode(2.0 * np.pi * TS * hz, 0.1) for hz in (33.0, 66.0)]
DELAYS = (-1.6e-4, 5e-3)  # s


def seen(H: Complex, noise: float = 0.003) -> FrequencyResponse:
    real, imaginary = np.random.default_rng(3).normal(size=(2, len(HZ)))
    one = np.ones(len(HZ))
    return FrequencyResponse(HZ, H * (1.0 + noise * (real + 1j * imaginary)), 0.9999 * one, one)


@pytest.mark.parametrize("gain", [0.95, 1.04])
def test_modes_delay_and_sensor_gain_are_found(gain: float) -> None:
    found = described(seen(gain * continuous(TWO.x, HZ)), ROUGH, DELAYS, (1.0, 0.03), speed=False)
    assert found.gain == pytest.approx(gain, rel=0.003)
    assert np.sort(found.hz) == pytest.approx([30.0, 70.0], rel=2e-3)
    assert found.delay == pytest.approx(0.0013, abs=3e-5)
    assert found.c[np.argsort(found.hz)] == pytest.approx([0.8, 0.2], abs=0.01)


def test_companions_of_a_mode_are_left_out() -> None:
    start = [*ROUGH, Mode(1.03 * ROUGH[0].omega, 0.02)]
    found = described(seen(continuous(TWO.x, HZ)), start, DELAYS, (1.0, 0.03), speed=True)
    assert np.sort(found.hz) == pytest.approx([30.0, 70.0], rel=5e-3)


def test_no_mode_leaves_its_range() -> None:
    """Not even for a measurement that no printer could make."""
    rng = np.random.default_rng(1)
    H = rng.normal(size=len(HZ)) + 1j * rng.normal(size=len(HZ))
    found = described(seen(H), ROUGH, DELAYS, (1.0, 0.03), speed=True)
    assert (found.hz >= 0.5 * HZ[0]).all()
    assert (found.hz <= 1.3 * HZ[-1]).all()
    assert DELAYS[0] <= found.delay <= DELAYS[1]
