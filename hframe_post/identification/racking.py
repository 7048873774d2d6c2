"""Racking: what the nozzle does in y while x sweeps, which grows with the distance from x_c."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hframe_post.errors import IdentificationError
from hframe_post.identification.diagnosis.scatter import lever_arm_uncertainty
from hframe_post.identification.estimation.along_x import at_common_frequencies, racking_along_x
from hframe_post.identification.estimation.axes import Fit, fit_racking
from hframe_post.identification.identified import Measured
from hframe_post.identification.responses.frequency_response import average
from hframe_post.identification.responses.measured import (
    LineOverPlaces,
    MeasurementSettings,
    RunGroup,
    RunResponse,
    centre,
    line,
)
from hframe_post.model.impulse_response import ImpulseResponse

OFF_LINE = 0.3  # of the lever arms' effect, that may deviate from the line through the positions
NOISE = 3.0  # times the noise, below which racking is not detected
APART = 20.0  # mm, at least, of the outer positions


@dataclass(frozen=True, slots=True)
class Racking:
    """Gxtheta as measured and as fitted, x_c in mm, and the uncertainty of lever arms."""

    measured: Measured
    fit: Fit
    x_c: float
    lever_arm_sd: tuple[float, float]


def find_racking(
    group: RunGroup, fits: Mapping[str, Fit], settings: MeasurementSettings, shifts: bool
) -> tuple[Racking | None, bool]:
    """Return what runs along x show of racking, and whether they could show any.

    fits: of the axes. shifts: whether modes shift along x. Raises IdentificationError if what the
    runs show is not racking.
    """
    G, runs = fits["Gxx"].G, group.runs
    moves = G if G.elsewhere else None
    if moves is not None:
        runs = [_unmoved(run, moves) for run in runs]
    arm = _lever_arm(runs, settings, shifts)
    if arm is None:
        return None, False
    if moves is not None:
        arm = _by_the_middle(arm, runs)
    if arm.over_noise <= (1.0 if arm.beyond_noise <= OFF_LINE else NOISE):
        return None, True
    # made of the same recordings as Gxx, so their delay is known by now
    delay = fits["Gxx"].recording_delay
    measured = Measured(arm.by_place, arm.slope, arm.off, arm.off, (delay, delay))
    along = average([run.response for run in runs])
    x_c, _ = centre(arm, along.H)
    fit = _fitted(measured, group, fits, settings)
    if moves is not None:
        turned = [(run.place, run.place - x_c, run.y) for run in runs]
        fit = replace(fit, G=racking_along_x(fit.G, moves, measured.mean, turned))
    sd = lever_arm_uncertainty([run.place for run in runs], [run.y for run in runs], along)
    return Racking(measured, fit, x_c, sd), True


def _fitted(
    measured: Measured, group: RunGroup, fits: Mapping[str, Fit], settings: MeasurementSettings
) -> Fit:
    low, high = settings.band_hz
    seen = measured.mean.within((max(low, group.excited_hz[0]), min(high, group.excited_hz[1])))
    # an unknown excitation is wrong in x alone, an unknown sensor where it measures
    calibrated = group.resonance_hz is None
    gain = fits["Gyy" if calibrated and "Gyy" in fits else "Gxx"].gain
    return fit_racking(seen, fits["Gxx"], gain, calibrated)


def _unmoved(run: RunResponse, moves: ImpulseResponse) -> RunResponse:
    """Return the run as if its frequencies were those where the response itself holds."""
    response, y = (at_common_frequencies(one, moves, run.place) for one in (run.response, run.y))
    return replace(run, response=response, y=y)


def _by_the_middle(arm: LineOverPlaces, runs: Sequence[RunResponse]) -> LineOverPlaces:
    """Return the line with what was measured nearest the middle instead of the mean.

    Where modes move, the outer places may rack differently, and would pull x_c to one side.
    """
    run = min(runs, key=lambda run: abs(run.place - arm.middle))
    return replace(arm, middle=run.place, at_middle=run.y.H)


def _lever_arm(
    runs: Sequence[RunResponse], settings: MeasurementSettings, changes: bool
) -> LineOverPlaces | None:
    """Return the line over positions whose slope is racking.

    None if the kinematics cannot rack or the positions are too close. changes: whether the printer
    changes along x, so that no straight line can be expected.
    """
    places, across = [run.place for run in runs], [run.y for run in runs]
    if not settings.racks or np.ptp(places) < APART:
        return None
    found = line(places, across)
    if found.over_noise <= NOISE or changes or found.beyond_noise <= OFF_LINE:
        return found
    raise IdentificationError(
        "what the nozzle does in y while x sweeps does not grow with the position: "
        f"{100 * found.beyond_noise:.0f} % of it deviate from a straight line. "
        "Are files of two places exchanged, or was the sensor moved between runs?"
    )
