"""Modes that shift as the gantry moves, distinguished from those that do not."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from hframe_post.arrays import TS
from hframe_post.identification.diagnosis.scatter import (
    ModeShift,
    find_mode_shift,
    position_spread,
    refit_calibrated,
    with_noise,
)
from hframe_post.identification.fitting.fit import Fit
from hframe_post.identification.fitting.modal import Data, Structure, fit
from hframe_post.identification.responses.frequency_response import (
    FrequencyResponse,
    average,
    weights,
)
from tests.simulator import Axis, Machine, Mode

HZ = np.arange(3.0, 100.01, 0.25)
BAND = (3.0, 100.0)
PLACES = (80.0, 110.0, 140.0, 170.0, 200.0)  # mm of x
HERE_HZ = 28.0


def measured(place: float, change: float, rng: np.random.Generator) -> FrequencyResponse:
    """The response at one position, if the mode changes by ``change`` over all of them."""
    hz = HERE_HZ * (1.0 + change * (place - PLACES[2]) / (PLACES[-1] - PLACES[0]))
    axis = Axis((Mode(hz, 0.05, 0.8), Mode(75.0, 0.05, 0.2)), delay=0.001)
    H = Machine(axis, axis).exact().Gxx.response(2.0 * np.pi * HZ * TS)
    one = np.ones(len(HZ))
    return with_noise(FrequencyResponse(HZ, H, 0.999 * one, one, 10.0), rng)


def shift(change: float, seed: int) -> ModeShift | None:
    rng = np.random.default_rng(seed)
    runs = [measured(place, change, rng) for place in PLACES]
    mean = average(runs)
    model = fit(Data(HZ, mean.H, weights(mean), BAND, (-1.6e-4, 5e-3)), Structure(2, False))
    G, delay = model.discrete(model.delay, model.gain), model.delay
    found = Fit(G, 4, 0.0, 1.0, model.gain, 0.0, delay, (0.0, delay), model, ())
    places = list(zip(PLACES, runs, strict=True))
    return find_mode_shift(found, places, partial(refit_calibrated, model))


@pytest.mark.parametrize("change", [0.1, 0.02, -0.05])
def test_the_shift_of_a_mode_is_found(change: float) -> None:
    found = shift(change, 1)
    assert found is not None
    assert (found.hz[1] - found.hz[0]) / HERE_HZ == pytest.approx(change, rel=0.1)


@pytest.mark.parametrize("seed", range(3))
def test_no_shift_is_found_for_modes_that_stay(seed: int) -> None:
    assert shift(0.0, seed) is None


def test_position_spread_is_large_near_a_mode_that_shifts() -> None:
    rng = np.random.default_rng(1)
    runs = [measured(place, 0.1, rng) for place in PLACES]
    still = [measured(place, 0.0, rng) for place in PLACES]
    peak = np.array([HERE_HZ])
    assert abs(position_spread(runs).at(peak)[0]) > 0.3
    assert abs(position_spread(runs).at(np.array([5.0]))[0]) < 0.05
    assert abs(position_spread(still).at(peak)[0]) < 0.05
