"""What several places along x show: modes that move, and racking.

Modes may change with the gantry's position, since a belt's free length, and with it its stiffness,
changes along x. The response of all places together is stretched to what each shows; where that
moves, an axis has the response of the middle. Racking is what the nozzle does in y while x moves,
which grows with the distance from x_c.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from hframe_post.arrays import TS
from hframe_post.errors import IdentificationError
from hframe_post.identification.estimation.axes import (
    Fit,
    Measured,
    fit_racking,
)
from hframe_post.identification.estimation.frequency_response import (
    FrequencyResponse,
    average,
    lowest,
    share_left,
)
from hframe_post.identification.estimation.measured import (
    LineOverPlaces,
    MeasurementSettings,
    RunGroup,
    RunResponse,
    centre,
    line,
)
from hframe_post.model.impulse_response import ImpulseResponse

DAY_TO_DAY = 0.05  # relative change of a printer as belts, bearings and temperature change
MOST = 0.2  # a model that scatters by more is wrong in another way
SCATTER = 0.002  # of the frequencies from run to run, relative
COUNTED_AS = 4  # positions that this usual scatter is worth
LEAST_SHIFT = 0.01  # over all positions
CHANCE = 1e-3  # that a shift is only noise
SHIFTS = np.exp(np.arange(-0.3, 0.3001, 0.004))  # of frequencies, that are tried


@dataclass(frozen=True, slots=True)
class ModeShift:
    """How the frequencies change along x.

    hz: the main resonance at the least and the greatest x (mm) that was measured.
    """

    hz: tuple[float, float]
    x: tuple[float, float]

    @property
    def message(self) -> str:
        return (
            f"the printer changes along x: a mode at {self.hz[0]:.1f} Hz for x = {self.x[0]:.0f} "
            f"mm lies at {self.hz[1]:.1f} Hz for x = {self.x[1]:.0f} mm"
        )


def find_mode_shift(
    G: ImpulseResponse, resonance_hz: float, places: Sequence[tuple[float, FrequencyResponse]]
) -> ModeShift | None:
    """Return how modes shift along x; None if they do not, or fewer than 3 positions tell.

    G: of all places together. places: (x in mm, response) of each run. A shift counts if it is
    above 1 % over the positions and has a chance of 0.1 % at most to be noise (Student's t). Three
    places lie close to any line by chance, so the scatter that is usual counts, too.
    """
    x = np.array([place for place, _ in places])
    if len(places) < 3 or np.ptp(x) == 0.0:
        return None
    change = np.array([_log_factor(G, response) for _, response in places])
    away, n = x - x.mean(), COUNTED_AS + len(x) - 2
    power = float(away @ away)
    slope = float(away @ change) / power
    off = change - change.mean() - slope * away
    sd = np.sqrt((COUNTED_AS * SCATTER**2 + float(off @ off)) / n / power)
    if abs(slope) * np.ptp(x) < LEAST_SHIFT or abs(slope) < stats.t.isf(CHANCE, n) * sd:
        return None
    ends = float(x.min()), float(x.max())
    first, last = (float(np.exp(change.mean() + slope * (end - x.mean()))) for end in ends)
    return ModeShift((first * resonance_hz, last * resonance_hz), ends)


def _log_factor(G: ImpulseResponse, measured: FrequencyResponse) -> float:
    """Return the logarithm of the factor of all frequencies with which G is most like a place."""
    hz = measured.hz
    fine = np.linspace(hz[0] / SHIFTS[-1], hz[-1] / SHIFTS[0], 4 * len(hz))
    H = G.response(2.0 * np.pi * TS * fine)

    def left(factor: float) -> float:
        at = hz / factor
        there = np.interp(at, fine, H.real) + 1j * np.interp(at, fine, H.imag)
        return share_left(there, measured, measured.power)

    return lowest(np.log(SHIFTS), [left(factor) for factor in SHIFTS.tolist()])


SAME_PLACE = 5.0  # mm


def at_the_middle(places: Sequence[tuple[float, FrequencyResponse]]) -> FrequencyResponse:
    """Return the mean response of the runs nearest to the middle of all places (mm)."""
    at = [place for place, _ in places]
    middle = (min(at) + max(at)) / 2.0
    nearest = min(at, key=lambda place: abs(place - middle))
    return average([response for place, response in places if abs(place - nearest) < SAME_PLACE])


OFF_LINE = 0.3  # of the lever arms' effect, that may deviate from the line through the positions
NOISE = 2.5  # least power of racking per that of its noise; without racking 0.9 to 2.0 are seen
APART = 20.0  # mm, at least, of the outer positions


@dataclass(frozen=True, slots=True)
class Racking:
    """Gxtheta as measured and as fitted, and x_c in mm."""

    measured: Measured
    fit: Fit
    x_c: float


def find_racking(
    group: RunGroup, fits: Mapping[str, Fit], settings: MeasurementSettings, shifts: bool
) -> tuple[Racking | None, bool]:
    """Return what runs along x show of racking, and whether they could show any.

    fits: of the axes. shifts: whether modes shift along x. Raises IdentificationError if what the
    runs show is not racking.
    """
    arm = _lever_arm(group.runs, settings, shifts)
    if arm is None:
        return None, False
    if arm.over_noise <= NOISE:
        return None, True
    measured = Measured(arm.by_place, arm.slope, arm.off, arm.off)
    along = average([run.response for run in group.runs])
    x_c, _ = centre(arm, along.H)
    return Racking(measured, _fitted(measured, group, fits, settings), x_c), True


def _fitted(
    measured: Measured, group: RunGroup, fits: Mapping[str, Fit], settings: MeasurementSettings
) -> Fit:
    low, high = settings.band_hz
    seen = measured.mean.within((max(low, group.excited_hz[0]), min(high, group.excited_hz[1])))
    # an unknown excitation is wrong in x alone, an unknown sensor where it measures
    calibrated = group.resonance_hz is None
    gain = fits["Gyy" if calibrated and "Gyy" in fits else "Gxx"].gain
    return fit_racking(seen, fits["Gxx"], gain, calibrated)


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
