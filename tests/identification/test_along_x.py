"""Modes that shift as the gantry moves, distinguished from those that do not."""

from dataclasses import replace

import numpy as np
import pytest

from hframe_post.arrays import TS
from hframe_post.identification.estimation.frequency_response import FrequencyResponse, average
from hframe_post.identification.estimation.response import fit_known_start
from hframe_post.identification.gather import Gathered
from hframe_post.identification.identify import MeasurementSettings, identify
from hframe_post.identification.places import (
    ModeShift,
    find_mode_shift,
)
from hframe_post.identification.report import IdentificationReport
from tests.quantities import below
from tests.random_printers import drawn, judged, printer, struck
from tests.simulator import Axis, Machine, Mode

HZ = np.arange(3.0, 100.01, 0.25)
BAND = (3.0, 100.0)
PLACES = (80.0, 110.0, 140.0, 170.0, 200.0)  # mm of x
HERE_HZ = 28.0


def with_noise(response: FrequencyResponse, rng: np.random.Generator) -> FrequencyResponse:
    """Return the response with random noise of the size that its coherence tells."""
    real, imaginary = rng.normal(size=(2, len(response.hz))) * np.sqrt(0.5)
    noise = response.noise * np.abs(response.H) * (real + 1j * imaginary)
    return replace(response, H=response.H + noise)


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
    found = fit_known_start(average(runs))
    return find_mode_shift(found.G, HERE_HZ, list(zip(PLACES, runs, strict=True)))


SLOW = pytest.mark.slow


@pytest.mark.parametrize(
    "change", [pytest.param(0.1, marks=SLOW), pytest.param(0.02, marks=SLOW), -0.05]
)
def test_the_shift_of_a_mode_is_found(change: float) -> None:
    found = shift(change, 1)
    assert found is not None
    assert (found.hz[1] - found.hz[0]) / HERE_HZ == pytest.approx(change, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, *(pytest.param(k, marks=SLOW) for k in (1, 2))])
def test_no_shift_is_found_for_modes_that_stay(seed: int) -> None:
    assert shift(0.0, seed) is None


@pytest.mark.slow
def test_a_printer_whose_modes_move_is_told_so_and_gets_the_model_of_the_middle() -> None:
    seed = 199
    machine, chip, _ = drawn(seed)
    profile = printer(machine)
    found = identify(
        struck(machine, chip, seed, 20.0), MeasurementSettings(BAND, racks=profile.kinematics.racks)
    )
    assert found.refusal is None
    left = judged(machine, replace(profile, plant=found.plant(machine.x_c)))
    below(left.compensated, 0.15 * left.none, "error of the rectangle, µm RMS")
    text = IdentificationReport(found, found.plant(machine.x_c), None, Gathered([], [])).remarks()
    assert any("one model is that of the middle" in line for line in text)
