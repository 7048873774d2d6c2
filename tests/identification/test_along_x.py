"""Modes that shift as the gantry moves, distinguished from those that do not."""

from dataclasses import replace

import numpy as np
import pytest

from hframe_post.arrays import TS, Complex
from hframe_post.identification.estimation.axes import fit_known_start
from hframe_post.identification.estimation.frequency_response import FrequencyResponse, average
from hframe_post.identification.gather import Gathered
from hframe_post.identification.identify import MeasurementSettings, identify
from hframe_post.identification.places import (
    ModeShift,
    at_common_frequencies,
    factor,
    find_mode_shift,
    fit_places,
    racking_along_x,
)
from hframe_post.identification.report import IdentificationReport
from hframe_post.model.impulse_response import Elsewhere, ImpulseResponse
from tests.modes import deviation_of_mode
from tests.quantities import below, near
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


OMEGA = 2.0 * np.pi * HZ * TS


def moving(change: float) -> ImpulseResponse:
    """Return a mode whose frequency changes so much from 140 to 200 mm."""

    def mode(hz: float) -> ImpulseResponse:
        return ImpulseResponse(deviation_of_mode(hz, 0.06, 500), 0, lag=1.0)

    ends = [
        Elsewhere(140.0 + side * 60.0, 1.0 + side * change, mode(HERE_HZ * (1.0 + side * change)))
        for side in (-1.0, 1.0)
    ]
    return replace(mode(HERE_HZ), x=140.0, elsewhere=tuple(ends))


def shown(H: Complex) -> FrequencyResponse:
    one = np.ones(len(HZ))
    return FrequencyResponse(HZ, H, 0.9999 * one, one, 10.0)


def off(found: Complex, wanted: Complex) -> float:
    return float(np.linalg.norm(found - wanted) / np.linalg.norm(wanted))


@pytest.mark.slow
def test_each_place_has_its_response_and_its_frequency() -> None:
    true, rng = moving(0.05), np.random.default_rng(0)
    at = (80.0, 140.0, 200.0)
    places = [(x, with_noise(shown(true.at(x).response(OMEGA)), rng)) for x in at]
    together = fit_known_start(average([one for _, one in places]))
    found = fit_places(together, places).G
    for x in (80.0, 100.0, 140.0, 180.0, 200.0):
        below(off(found.at(x).response(OMEGA), true.at(x).response(OMEGA)), 0.03, f"error, {x} mm")
        near(factor(found, x), factor(true, x), 0.003, "factor of the frequency")


def test_runs_at_common_frequencies_are_alike() -> None:
    G = moving(0.05)
    runs = [
        at_common_frequencies(shown(G.at(x).response(OMEGA)), G, x) for x in (80.0, 140.0, 200.0)
    ]
    assert all(np.array_equal(run.hz, runs[0].hz) for run in runs)
    for run in runs:
        below(off(run.H, G.response(2.0 * np.pi * TS * run.hz)), 0.02, "error of the response")


def test_racking_moves_with_the_axis_and_keeps_its_measured_size() -> None:
    G, x_c = moving(0.05), 147.0
    axis = Axis((Mode(HERE_HZ, 0.06),))
    racking = Machine(axis, axis, racking=2e-8, racking_mode=Mode(50.0, 0.1)).exact().Gxtheta
    assert racking is not None
    slope = shown(racking.response(OMEGA))
    larger = {80.0: 0.9, 140.0: 1.0, 200.0: 1.2}
    seen = [(x, x - x_c, shown(size * (x - x_c) * slope.H)) for x, size in larger.items()]
    found = racking_along_x(racking, G, slope, seen)
    below(off(found.response(OMEGA), slope.H), 0.01, "error of racking where it holds")
    for one in found.elsewhere:
        stretched = replace(found, elsewhere=()).stretched(1.0 / factor(G, one.x))
        wanted = larger[one.x] * stretched.response(OMEGA)
        below(off(one.G.response(OMEGA), wanted), 0.01, f"error of racking at x = {one.x} mm")
    assert [one.x for one in found.elsewhere] == [80.0, 200.0]


@pytest.mark.slow
def test_a_printer_whose_modes_move_is_compensated_all_along_x() -> None:
    """One model leaves 12 µm of it."""
    seed = 199
    machine, chip, _ = drawn(seed)
    profile = printer(machine)
    found = identify(
        struck(machine, chip, seed), MeasurementSettings(BAND, racks=profile.kinematics.racks)
    )
    assert found.refusal is None
    assert set(found.along_x) == {"Gxx", "Gyy", "Gxtheta"}
    own = replace(profile, plant=found.plant(machine.x_c))
    still = replace(
        machine, along=0.0,
        x=_faster(machine.x, 1.0 + machine.along * (200.0 - machine.middle)),
        y=_faster(machine.y, 1.0 + machine.along * (200.0 - machine.middle)),
    )  # fmt: skip
    exact = judged(still, replace(profile, plant=still.exact()))
    left = judged(machine, own)
    below(left.compensated, 1.3 * exact.compensated, "error of the rectangle, µm RMS")
    text = IdentificationReport(found, found.plant(machine.x_c), None, Gathered([], [])).remarks()
    assert any(line.startswith("along x") and "frequencies change by" in line for line in text)
    assert not any("one model is that of the middle" in line for line in text)


def _faster(axis: Axis, by: float) -> Axis:
    return replace(axis, modes=tuple(replace(mode, hz=by * mode.hz) for mode in axis.modes))
