"""Uncertainty of a model: the scatter of repeated measurements."""

from __future__ import annotations

import numpy as np
import pytest

from hframe_post.arrays import Array
from hframe_post.identification.diagnosis.scatter import (
    DAY_TO_DAY,
    Uncertainty,
    lever_arm_uncertainty,
    model_uncertainty,
)
from hframe_post.identification.fitting.fit import Fit, fit
from hframe_post.identification.responses.frequency_response import FrequencyResponse, average
from tests.identification.modal_tools import BAND, HZ, TWO, continuous

RUNS = 4


def measured(noise: float, seed: int) -> list[FrequencyResponse]:
    rng = np.random.default_rng(seed)
    H = continuous(TWO.x, HZ)
    coherence = np.full(len(HZ), 1.0 / (1.0 + noise**2))
    runs = []
    for _ in range(RUNS):
        real, imaginary = rng.normal(size=(2, len(HZ))) * np.sqrt(0.5)
        response = H + noise * np.abs(H) * (real + 1j * imaginary)
        runs.append(FrequencyResponse(HZ, response, coherence, np.ones(len(HZ))))
    return runs


def known(noise: float, seed: int) -> tuple[Fit, Uncertainty]:
    runs = measured(noise, seed)
    found = fit(runs, average(runs), False, BAND)
    sure = model_uncertainty(found, runs, BAND)
    return found, sure


@pytest.mark.slow
def test_uncertainty_is_the_scatter_of_repeated_measurements() -> None:
    several = [known(0.05, seed) for seed in range(6)]
    lowest = np.array([found.modes[0][0] for found, _ in several])
    scatter = float(np.std(lowest) / np.mean(lowest))
    estimated = float(np.mean([sure.hz[0] for _, sure in several]))
    assert scatter / 3.0 < estimated < 3.0 * scatter


@pytest.mark.slow
def test_more_noise_means_more_uncertainty() -> None:
    (_, quiet), (_, loud) = (known(noise, 1) for noise in (0.01, 0.1))
    assert loud.hz[0] > 3.0 * quiet.hz[0]
    assert loud.share > quiet.share
    assert quiet.share < DAY_TO_DAY


def test_uncertainty_of_the_centre_grows_with_the_noise() -> None:
    along = average(measured(0.01, 1))
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
