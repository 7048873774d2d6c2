"""What several places along x show: a response that changes, and racking.

A response may change with the gantry's position, since a belt's free length, and with it its
stiffness, changes along x. An axis that changes has the response of the middle. Racking is what the
nozzle does in y while x moves, which grows with the distance from x_c.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hframe_post.arrays import Array, Complex
from hframe_post.errors import IdentificationError
from hframe_post.identification import verdict
from hframe_post.identification.estimation.fit import Fit
from hframe_post.identification.estimation.frequency_response import (
    FrequencyResponse,
    average,
)
from hframe_post.identification.estimation.measured import (
    Measured,
    MeasurementSettings,
    RunResponse,
)
from hframe_post.identification.estimation.response import fit_racking
from hframe_post.identification.recordings.runs import NEAREST

DAY_TO_DAY = 0.05  # relative change of a printer as belts, bearings and temperature change


def changes(axis: Measured) -> bool:
    """Return whether one model cannot describe an axis at all places."""
    return axis.spread > verdict.MISFIT


def at_the_middle(places: Sequence[tuple[float, FrequencyResponse]]) -> FrequencyResponse:
    """Return the mean response of the runs nearest to the middle of all places (mm)."""
    at = [place for place, _ in places]
    middle = (min(at) + max(at)) / 2.0
    nearest = min(at, key=lambda place: abs(place - middle))
    return average([response for place, response in places if abs(place - nearest) < NEAREST])


OFF_LINE = 0.3  # of the lever arms' effect, that may deviate from the line through the positions
# least power of racking, or of what is off the line, per that of its noise; without racking 0.9 to
# 2.0 are seen
NOISE = 2.5


@dataclass(frozen=True, slots=True)
class Racking:
    """Gxtheta as measured and as fitted, and x_c in mm."""

    measured: Measured
    fit: Fit
    x_c: float


def find_racking(
    group: Measured, fits: Mapping[str, Fit], settings: MeasurementSettings
) -> tuple[Racking | None, bool]:
    """Return what runs along x show of racking, and whether they could show any.

    fits: of the axes. Raises IdentificationError if what the runs show is not racking.
    """
    arm = _lever_arm(group, settings)
    if arm is None:
        return None, False
    if arm.over_noise <= NOISE:
        return None, True
    each = [RunResponse(place, slope, slope, None) for place, slope in arm.by_place]
    measured = Measured(each, arm.slope, arm.off, arm.off)
    along = average([run.response for run in group.runs])
    x_c, _ = centre(arm, along.H)
    return Racking(measured, _fitted(measured, group, fits, settings), x_c), True


def _fitted(
    measured: Measured, group: Measured, fits: Mapping[str, Fit], settings: MeasurementSettings
) -> Fit:
    low, high = settings.band_hz
    seen = measured.mean.within((max(low, group.excited_hz[0]), min(high, group.excited_hz[1])))
    # an unknown excitation is wrong in x alone, an unknown sensor where it measures
    calibrated = group.known_start
    gain = fits["Gyy" if calibrated and "Gyy" in fits else "Gxx"].gain
    return fit_racking(seen, fits["Gxx"], gain)


def _lever_arm(group: Measured, settings: MeasurementSettings) -> LineOverPlaces | None:
    """Return the line over positions whose slope is racking.

    None if the kinematics cannot rack or the positions are too close. Of a printer that changes
    along x no straight line can be expected.
    """
    places, across = [run.place for run in group.runs], [run.y for run in group.runs]
    if not settings.racks or np.ptp(places) < 2.0 * NEAREST:
        return None
    found = line(places, across)
    if found.over_noise <= NOISE or changes(group) or found.beyond_noise <= OFF_LINE:
        return found
    raise IdentificationError(
        "what the nozzle does in y while x sweeps does not grow with the position: "
        f"{100 * found.beyond_noise:.0f} % of it deviate from a straight line. "
        "Are files of two places exchanged, or was the sensor moved between runs?"
    )


# ----------------------------------------------------------------------
# The lever arm of eq. 2: a run in x with the gantry at x = p moves the nozzle in y by the lever
# arm times θ, and a sensor rotated by a small ψ about the vertical adds its share of x. Per x,
#
#     H_y(p) = (p − x_c)·Gxθ + ψ·Gxx
#
# is a straight line over p: its slope is Gxθ, whatever ψ; its offset gives x_c and ψ.


@dataclass(frozen=True, slots=True)
class LineOverPlaces:
    """The straight line over places, (k,) frequencies each.

    slope: Gxθ (rad/mm). middle: the mean place, mm. at_middle (k,): H_y there.
    off: RMS deviation of the places from the line, relative to the part that varies with the
    place; beyond_noise: the same without the part that noise explains, 0 if it may explain all.
    over_noise: power of the slope over that of its noise. by_place: each place (mm), and the slope
    from it alone.
    """

    slope: FrequencyResponse
    middle: float
    at_middle: Complex
    off: float
    beyond_noise: float
    over_noise: float
    by_place: list[tuple[float, FrequencyResponse]]


def line(places: Sequence[float], responses: Sequence[FrequencyResponse]) -> LineOverPlaces:
    """Fit the line by least squares to H_y (k,) at two places (mm) or more."""
    first = responses[0]
    p = np.asarray(places)
    middle = float(p.mean())
    arm = p - middle
    H = np.array([r.H for r in responses])
    weights = arm / (arm @ arm)
    averages = min(r.averages for r in responses)
    slope, at_middle = weights @ H, H.mean(axis=0)
    noise = np.array([_noise(r) / r.averages for r in responses])
    power = np.mean([r.power for r in responses], axis=0)
    by_arm = np.outer(arm, slope)
    off = H - at_middle - by_arm
    size = (power * np.abs(by_arm) ** 2).sum()
    off_line = (power * np.abs(off) ** 2).sum() / size
    by_noise = (power * noise).sum() * (1.0 - 2.0 / len(p)) / size
    slope_noise = (power * (weights**2 @ noise)).sum()

    def response(value: Complex, noise: Array) -> FrequencyResponse:
        signal = np.abs(value) ** 2
        power_of_all = signal + averages * noise
        coherence = np.divide(signal, power_of_all, out=np.zeros_like(signal), where=signal > 0.0)
        return FrequencyResponse(first.hz, value, coherence, power, averages)

    return LineOverPlaces(
        response(slope, weights**2 @ noise),
        middle,
        at_middle,
        float(np.sqrt(off_line)),
        float(np.sqrt(off_line - by_noise)) if off_line > NOISE * by_noise else 0.0,
        float((power * np.abs(slope) ** 2).sum() / max(slope_noise, np.finfo(float).tiny)),
        [
            (place, response((h - at_middle) / a, n / a**2))
            for place, a, h, n in zip(p.tolist(), arm.tolist(), H, noise, strict=True)
            if abs(a) >= NEAREST  # a place nearer the middle shows nothing of the slope
        ],
    )


def centre(line: LineOverPlaces, Gxx: Complex) -> tuple[float, float]:
    """Return x_c (mm) and ψ (rad) from the line's offset. Gxx (k,): as measured."""
    weight = np.sqrt(line.slope.power)
    columns = np.column_stack([line.slope.H, Gxx]) * weight[:, None]
    target = line.at_middle * weight
    stacked = np.concatenate([columns.real, columns.imag])
    (arm, psi), *_ = np.linalg.lstsq(
        stacked, np.concatenate([target.real, target.imag]), rcond=None
    )
    return line.middle - float(arm), float(psi)


def _noise(response: FrequencyResponse) -> Array:
    """Return the power that the command does not explain, per power of the command, (k,).

    Of one estimate: that of the mean of several is as many times smaller.
    """
    coherence = np.clip(response.coherence, 1e-12, 1.0)
    noise: Array = (1.0 / coherence - 1.0) * np.abs(response.H) ** 2
    return noise
