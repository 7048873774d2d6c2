"""What a mode prints, and the mode that shows in a print: waves on a wall behind a corner.

Up to the corner one axis brakes from the band's speed to that of the corner, and stops there at
once; the other one goes on along the wall. From then on the first one rings. Its waves are seen as
long as they are higher than some hundredths of a millimetre, which is not known exactly: waves of
hard and soft corners tell it.

A mode with the poles s₁ and s̄₁ responds to a command U with G·U, G = |s₁|²/((s − s₁)(s − s̄₁)). Of a
command of straight lines, s²U is pulses at the samples, so an ``ImpulseResponse`` is exact. Its
deviation is the inverse Laplace transform of G/s², without the double pole at rest, which is the
command and its lag of 2ζ/ω.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.signal import find_peaks

from hframe_post.arrays import TS, Array
from hframe_post.errors import HframeError, IdentificationError
from hframe_post.identification.tower import LAYER, LAYERS, SIDE, Band
from hframe_post.model.impulse_response import FiniteFilter, ImpulseResponse

RULER = 0.3  # mm by which a distance may be read wrong
MISCOUNT = 0.6  # waves by which their number may be
DAMPING = np.array([0.02, 0.03, 0.04, 0.05, 0.06, 0.075, 0.09, 0.11, 0.13, 0.16, 0.2])
SEEN_FROM = np.geomspace(0.008, 0.03, 9)  # mm: the lowest wave that is seen
USUAL, SPREAD = 0.016, 0.35  # mm, and standard deviation of its logarithm
PLAUSIBLE_HZ = (8.0, 120.0)
# waves behind a corner where a reading begins: the form says the second crest, and the first one is
# a quarter of a wave behind the corner, since the axis stops at once
SECOND_CREST = 1.25
FREQUENCIES, HALVINGS = (1.0, 2000.0), 40  # Hz within which a reading's is sought
CANDIDATES = 400


@dataclass(frozen=True, slots=True)
class Reading:
    """What was read on a band: mm over a number of waves, and how many waves are seen at all."""

    band: Band
    distance: float
    waves: float
    seen: float


@dataclass(frozen=True, slots=True)
class PrintedMode:
    """A mode read from a print.

    uncertainty: standard deviation of its frequency, relative. seen_from: mm, the lowest wave that
    was seen.
    """

    hz: float
    damping: float
    uncertainty: float
    seen_from: float

    def response(self) -> ImpulseResponse:
        return ImpulseResponse.from_mode(self.hz, self.damping)


def corner_path(band: Band, a: float, side: float) -> tuple[Array, int]:
    """Return the path around a corner, (n, 2) mm every 1 ms, and the sample of the corner.

    It comes along the first axis and leaves along the second, each time from the corner's speed to
    the band's and back. a: mm/s²; side: mm.
    """
    ramp = (band.speed - band.corner) / a
    cruise = (side - (band.speed + band.corner) * ramp) / band.speed
    t = np.arange(round((2.0 * ramp + cruise) / TS)) * TS
    gaining, braking = np.minimum(t, ramp), np.maximum(t - ramp - cruise, 0.0)
    fast = (band.speed - band.corner) * np.maximum(t - ramp, 0.0)
    way = band.corner * t + fast + 0.5 * a * (gaining**2 - braking**2)
    still = np.zeros(len(way))
    first, second = np.concatenate([way - side, still]), np.concatenate([still, way])
    return np.column_stack([first, second]), len(way)


def printed_mode(readings: Sequence[Reading], a: float, side: float) -> PrintedMode:
    """Return the mode that readings of one axis show. Raises IdentificationError.

    A reading that differs from the others, such as one with a wave too many, hardly counts.
    """
    measured = [one for one in readings if one.waves > 0.0]
    if not measured:
        raise IdentificationError("no row has a distance and a number of waves: fill in the form")
    hz = np.array([frequency(one, a, side) for one in measured])
    steps = np.diff([[frequency(replace(one, distance=one.distance + sign * RULER), a, side)
                      for sign in (-1.0, 1.0)] for one in measured])  # fmt: skip
    by_ruler = np.abs(steps[:, 0]) / (2.0 * hz)  # relative, of each
    mean = _agreed(hz, by_ruler)
    low, high = PLAUSIBLE_HZ
    if not low <= mean <= high:
        raise IdentificationError(
            f"these waves mean {mean:.0f} Hz, but printers ring at {low:g} to {high:g} Hz: check "
            "that each distance is in mm and over all of the waves that you counted, not over one"
        )
    weight = by_ruler**-2.0
    apart = math.sqrt(weight @ np.log(hz / mean) ** 2 / weight.sum())
    damping, seen_from = _fading(readings, mean, a, side)
    natural = mean / math.sqrt(1.0 - damping**2)
    uncertainty = max(float(weight.sum() ** -0.5), apart)
    return PrintedMode(natural, damping, uncertainty, seen_from)


def frequency(one: Reading, a: float, side: float) -> float:
    """Return the frequency, Hz, at which waves are as far apart as they were read.

    They are closer together where the head is still gaining speed: in the ramp behind the corner.
    """
    path, corner = corner_path(one.band, a, side)
    along, t = path[corner:, 1], np.arange(len(path) - corner) * TS
    low, high = FREQUENCIES
    for _ in range(HALVINGS):
        hz = math.sqrt(low * high)
        crests = (SECOND_CREST + np.array([0.0, one.waves])) / hz
        near, far = np.interp(crests, t, along, right=2.0 * side).tolist()
        low, high = (hz, high) if far - near > one.distance else (low, hz)
    return math.sqrt(low * high)


def _agreed(hz: Array, off: Array) -> float:
    """Return the frequency that most of some (k,) agree on; off (k,): their relative errors."""
    candidates = np.geomspace(hz.min(), hz.max(), CANDIDATES)
    apart = np.log(hz / candidates[:, None]) / off
    return float(candidates[np.argmin(np.log1p(apart**2).sum(axis=1))])


def _fading(readings: Sequence[Reading], hz: float, a: float, side: float) -> tuple[float, float]:
    """Return the damping and the lowest visible wave that explain how many waves are seen."""
    cost = np.tile((np.log(SEEN_FROM / USUAL) / SPREAD) ** 2, (len(DAMPING), 1))
    for one in readings:
        path, corner = corner_path(one.band, a, side)
        for row, damping in zip(cost, DAMPING.tolist(), strict=True):
            G = FiniteFilter(ImpulseResponse.from_mode(hz, damping), 0)
            wall = np.abs(G.run(path[:, 0] + side) - side)[corner:]
            heights = wall[find_peaks(wall)[0]]  # of crests and troughs
            seen = (heights > SEEN_FROM[:, None]).sum(axis=1) / 2.0
            row += ((seen - one.seen) / MISCOUNT) ** 2
    likely = np.exp(-0.5 * (cost - cost.min()))
    likely /= likely.sum()
    damping, lowest = likely.sum(axis=1) @ np.log(DAMPING), likely.sum(axis=0) @ np.log(SEEN_FROM)
    return math.exp(damping), math.exp(lowest)


# ----------------------------------------------------------------------
# The form in which the owner notes what the tower shows, and the plant that follows from it.

WALLS = {"x": "right wall", "y": "back wall"}
LEAST_UNCERTAINTY, MOST_UNCERTAINTY = 0.1, 0.3  # second modes are not seen; a ruler reads no worse
MOST = 1e5  # of any number
APART, HEAVIER = 0.15, 1.25  # share by which a row may differ; of the frequencies of y and x
HEAD = """\
# What the tower shows. Hold it so that light falls along a wall, and look at the waves behind the
# corner. A wave goes from one crest to the next. Each row takes three numbers:
#   1. mm on the ruler from the second crest to the last one that is clear: in all, not of one wave
#   2. how many waves that is
#   3. how many waves you see before they fade, from the corner on; halves count
# Example: from the second crest to the sixth are 9.5 mm and 4 waves; 5 and a half are seen:
#   x1 = [9.5, 4, 5.5]
# Leave a row of zeros where you see none.
"""


ROW = "A row reads like x1 = [9.5, 4, 5.5], with a point in 9.5: mm, over how many waves, seen"


def form(bands: Sequence[Band], acceleration: float) -> str:
    """Return an empty form for a tower with these bands, printed with mm/s²."""
    rows = [f"{HEAD}", "[print]", f"acceleration = {acceleration:g}"]
    rows += [f"speeds = {[band.speed for band in bands]}"]
    rows += [f"corners = {[round(band.corner, 3) for band in bands]}", "", "[waves]"]
    for axis, its_wall in WALLS.items():
        for k, band in enumerate(bands):
            low, high = k * LAYERS * LAYER, (k + 1) * LAYERS * LAYER
            where = f"{its_wall}, {low:g} to {high:g} mm up, {band.speed:g} mm/s"
            rows.append(f"{axis}{k + 1} = [0, 0, 0]".ljust(28) + f"# {where}")
    return "\n".join([*rows, ""])


@dataclass(frozen=True, slots=True)
class Filled:
    """A form that was filled in: readings by axis, and mm/s² of the print."""

    readings: dict[str, list[Reading]]
    acceleration: float

    def modes(self) -> dict[str, PrintedMode]:
        """Return the mode of each axis. Raises IdentificationError, which names the axis."""
        found = {}
        for axis, readings in self.readings.items():
            try:
                found[axis] = printed_mode(readings, self.acceleration, SIDE)
            except IdentificationError as error:
                raise IdentificationError(f"{axis}, {WALLS[axis]}: {error}") from None
        return found

    def hertz(self) -> dict[str, dict[str, float]]:
        """Return the frequencies, Hz, that the rows of each axis mean, by the rows' names."""
        return {
            axis: {
                f"{axis}{k}": frequency(one, self.acceleration, SIDE)
                for k, one in enumerate(readings, 1)
                if one.waves
            }
            for axis, readings in self.readings.items()
        }

    def doubts(self, modes: dict[str, PrintedMode], bed_moves: bool) -> list[str]:
        """Return what the owner should look at again, in words.

        bed_moves: the bed, with the print on it, is what y moves.
        """
        found = [
            doubt
            for axis, rows in self.hertz().items()
            for name, its_own in rows.items()
            for doubt in self._doubts_of_row(axis, name, its_own, modes[axis].hz)
        ]
        if bed_moves and modes["y"].hz > HEAVIER * modes["x"].hz:
            found.append(
                "the bed rings faster in y than the head in x. Beds are heavier: did you exchange "
                "the rows of x and y?"
            )
        return found

    def _doubts_of_row(self, axis: str, name: str, its_own: float, hz: float) -> Iterator[str]:
        one = self.readings[axis][int(name[1:]) - 1]
        if abs(its_own / hz - 1.0) > APART:
            yield (
                f"row {name} means {its_own:.0f} Hz and {axis} has {hz:.0f}: count its waves "
                "again. Is it the row of another height?"
            )
        elif one.seen < SECOND_CREST + one.waves:
            yield (
                f"row {name} has {one.waves:g} waves from the second crest on, but only "
                f"{one.seen:g} from the corner on, in all: did you count crests?"
            )


def filled(text: str, source: str) -> Filled:
    """Return a filled form. Raises HframeError, which names the row."""
    try:
        document = tomllib.loads(text)
        printed, waves = document["print"], dict(document["waves"])
        pairs = zip(printed["speeds"], printed["corners"], strict=True)
        bands = [Band(float(speed), float(corner)) for speed, corner in pairs]
        acceleration = float(printed["acceleration"])
    except (ValueError, KeyError, TypeError) as error:
        hint = f". {ROW}" if isinstance(error, tomllib.TOMLDecodeError) else ""
        raise HframeError(
            f"{source} is not a form of 'hframe-post calibrate-print': {error}{hint}"
        ) from None
    readings = {
        axis: [
            _reading(band, waves.get(f"{axis}{k}", [0, 0, 0]), f"{source}: {axis}{k}")
            for k, band in enumerate(bands, 1)
        ]
        for axis in WALLS
    }
    return Filled(readings, acceleration)


def _reading(band: Band, row: Any, name: str) -> Reading:
    """Return a row of the form. Raises HframeError for what no ruler shows."""
    valid = isinstance(row, list) and len(row) == 3
    if not (valid and all(isinstance(one, int | float) and 0.0 <= one < MOST for one in row)):
        raise HframeError(f"{name} must be three numbers. {ROW}")
    one = Reading(band, *map(float, row))
    if (one.distance > 0.0) != (one.waves > 0.0):
        raise HframeError(
            f"{name} has a distance without waves, or waves without one. Write both, or [0, 0, "
            f"{one.seen:g}] if the waves are seen but cannot be measured"
        )
    return one
