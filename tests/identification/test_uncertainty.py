"""Uncertainty of racking: the scatter of repeated measurements."""

from __future__ import annotations

import numpy as np
import pytest

from hframe_post.arrays import Array
from hframe_post.identification.estimation.frequency_response import FrequencyResponse
from hframe_post.identification.places import lever_arm_uncertainty
from tests.identification.modal_tools import HZ, TWO, continuous


def test_uncertainty_of_the_centre_grows_with_the_noise() -> None:
    one = np.ones(len(HZ))
    along = FrequencyResponse(HZ, continuous(TWO.x, HZ), 0.9999 * one, one)
    places = [80.0, 140.0, 200.0]
    theta = 1e-3 * (2.0 * np.pi * HZ) ** 2 / 1e4

    def across(noise: float) -> tuple[float, float]:
        coherence: Array = np.full(len(HZ), 1.0 / (1.0 + noise**2))
        power = np.ones(len(HZ))
        response = [
            FrequencyResponse(HZ, ((p - 130.0) * theta).astype(complex), coherence, power)
            for p in places
        ]
        return lever_arm_uncertainty(places, response, along)

    (x_c, size), (worse, less) = across(0.02), across(0.2)
    assert 0.0 < x_c < worse < 20.0
    assert less == pytest.approx(10.0 * size, rel=0.5)
