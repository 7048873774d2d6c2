"""Which model a measurement asks for, of a printer that is linear and of one that is not."""

from __future__ import annotations

import numpy as np
import pytest

from hframe_post.arrays import TS, Complex
from hframe_post.identification.fitting.fit import fit
from hframe_post.identification.fitting.modal import Modal
from hframe_post.identification.fitting.weighting import Distortion
from hframe_post.identification.responses.frequency_response import FrequencyResponse
from tests.simulator import Axis, Machine, Mode

HZ = np.arange(3.0, 100.01, 0.25)
BAND = (3.0, 100.0)
GAIN, PEAK_HZ = 1.02, 40.0


def measured(hz: float, damping: float) -> Complex:
    axis = Axis((Mode(hz, damping),), delay=0.001)
    return Machine(axis, axis).exact().Gxx.response(2.0 * np.pi * HZ * TS)


@pytest.fixture(scope="module")
def bent() -> tuple[FrequencyResponse, Distortion]:
    """A belt that gets softer where the resonance pulls it: a peak that leans over."""
    right = measured(PEAK_HZ, 0.06)
    leaning = 0.5 * (right + measured(0.96 * PEAK_HZ, 0.045))
    one = np.ones(len(HZ))
    response = FrequencyResponse(HZ, GAIN * leaning, 0.9999 * one, one, 50.0)
    return response, Distortion(HZ, (leaning - right) / leaning, 0.0)


def test_what_is_not_linear_does_not_pass_for_modes(
    bent: tuple[FrequencyResponse, Distortion],
) -> None:
    response, distortion = bent
    found = fit([response], response, None, 1.0, BAND, distortion=distortion)
    assert isinstance(found.model, Modal)
    assert found.order == 2
    (hz, _), *_ = found.modes
    assert hz == pytest.approx(PEAK_HZ, rel=0.03)
    assert found.gain == pytest.approx(GAIN, abs=0.005)
    assert found.residual_over_noise < 1.5  # what is missed is what harmonics tell


def test_of_a_linear_printer_the_same_is_two_modes(
    bent: tuple[FrequencyResponse, Distortion],
) -> None:
    response, _ = bent
    found = fit([response], response, None, 1.0, BAND)
    assert found.order == 4
    assert found.residual < 0.01
