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
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
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
SOUGHT: Array = np.geomspace(2.0, 2000.0, 4000)  # Hz that a reading may mean


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

    uncertainty: standard deviation of its frequency, relative. rows: Hz of each reading, 0 of one
    without waves.
    """

    hz: float
    damping: float
    uncertainty: float
    rows: list[float]

    def response(self) -> ImpulseResponse:
        return ImpulseResponse.from_mode(self.hz, self.damping)


def corner_path(band: Band, a: float) -> tuple[Array, int]:
    """Return the path around a corner, (n, 2) mm every 1 ms, and the sample of the corner.

    It comes along the first axis and leaves along the second, each time from the corner's speed to
    the band's and back. a: mm/s².
    """
    ramp = (band.speed - band.corner) / a
    cruise = (SIDE - (band.speed + band.corner) * ramp) / band.speed
    t = TS * np.arange(round((2.0 * ramp + cruise) / TS), dtype=np.float64)
    braked = 0.5 * a * np.maximum(t - ramp - cruise, 0.0) ** 2
    way, still = _way(band, a, t) - braked, np.zeros(len(t))
    first, second = np.concatenate([way - SIDE, still]), np.concatenate([still, way])
    return np.column_stack([first, second]), len(way)


def _way(band: Band, a: float, t: Array) -> Array:
    """Return mm behind a corner at times t (n,) in s, while the head gains the band's speed."""
    gaining = np.minimum(t, (band.speed - band.corner) / a)
    return band.corner * t + a * gaining * (t - 0.5 * gaining)


def printed_mode(readings: Sequence[Reading], a: float) -> PrintedMode:
    """Return the mode that readings of one axis show. Raises IdentificationError.

    A reading that differs from the others, such as one with a wave too many, hardly counts.
    """
    measured = [one for one in readings if one.waves > 0.0]
    if not measured:
        raise IdentificationError("no row has a distance and a number of waves: fill in the form")
    hz, high, low = np.transpose(
        [[frequency(one, a, off) for off in (0.0, -RULER, RULER)] for one in measured]
    )
    by_ruler = (high - low) / (2.0 * hz)  # relative, of each
    mean = _agreed(hz, by_ruler)
    least, most = PLAUSIBLE_HZ
    if not least <= mean <= most:
        raise IdentificationError(
            f"these waves mean {mean:.0f} Hz, but printers ring at {least:g} to {most:g} Hz: check "
            "that each distance is in mm and over all of the waves that you counted, not over one"
        )
    weight = by_ruler**-2.0
    apart = math.sqrt(weight @ np.log(hz / mean) ** 2 / weight.sum())
    damping = _damping(readings, mean, a)
    natural = mean / math.sqrt(1.0 - damping**2)
    uncertainty = max(float(weight.sum() ** -0.5), apart)
    rows = [frequency(one, a) if one.waves else 0.0 for one in readings]
    return PrintedMode(natural, damping, uncertainty, rows)


def frequency(one: Reading, a: float, off: float = 0.0) -> float:
    """Return the frequency, Hz, at which waves are as far apart as they were read.

    They are closer together where the head is still gaining speed: in the ramp behind the corner.
    off: mm by which the distance may be wrong.
    """
    near, far = (_way(one.band, a, (SECOND_CREST + n) / SOUGHT) for n in (0.0, one.waves))
    return float(np.interp(-one.distance - off, near - far, SOUGHT))


def _agreed(hz: Array, off: Array) -> float:
    """Return the frequency that most of some (k,) agree on; off (k,): their relative errors."""
    candidates = np.geomspace(hz.min(), hz.max(), 400)
    apart = np.log(hz / candidates[:, None]) / off
    return float(candidates[np.argmin(np.log1p(apart**2).sum(axis=1))])


def _damping(readings: Sequence[Reading], hz: float, a: float) -> float:
    """Return the damping that explains how many waves are seen, whatever the lowest visible one."""
    cost = np.tile((np.log(SEEN_FROM / USUAL) / SPREAD) ** 2, (len(DAMPING), 1))
    for one in readings:
        path, corner = corner_path(one.band, a)
        for row, damping in zip(cost, DAMPING.tolist(), strict=True):
            G = FiniteFilter(ImpulseResponse.from_mode(hz, damping), 0)
            wall = np.abs(G.run(path[:, 0] + SIDE) - SIDE)[corner:]
            heights = wall[find_peaks(wall)[0]]  # of crests and troughs
            seen = (heights > SEEN_FROM[:, None]).sum(axis=1) / 2.0
            row += ((seen - one.seen) / MISCOUNT) ** 2
    likely = np.exp(-0.5 * (cost - cost.min())).sum(axis=1)
    return math.exp(likely @ np.log(DAMPING) / likely.sum())


# ----------------------------------------------------------------------
# The form in which the owner notes what the tower shows, and the plant that follows from it.

WALLS = {"x": "right wall", "y": "back wall"}
LEAST_UNCERTAINTY, MOST_UNCERTAINTY = 0.1, 0.3  # second modes are not seen; a ruler reads no worse
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
                found[axis] = printed_mode(readings, self.acceleration)
            except IdentificationError as error:
                raise IdentificationError(f"{axis}, {WALLS[axis]}: {error}") from None
        return found

    def doubts(self, modes: dict[str, PrintedMode], bed_moves: bool) -> Iterator[str]:
        """Yield what the owner should look at again, in words.

        bed_moves: the bed, with the print on it, is what y moves.
        """
        for axis, mode in modes.items():
            for k, (one, its_own) in enumerate(zip(self.readings[axis], mode.rows, strict=True), 1):
                if its_own and abs(its_own / mode.hz - 1.0) > APART:
                    yield (
                        f"row {axis}{k} means {its_own:.0f} Hz and {axis} has {mode.hz:.0f}: count "
                        "its waves again. Is it the row of another height?"
                    )
                elif its_own and one.seen < SECOND_CREST + one.waves:
                    yield (
                        f"row {axis}{k} has {one.waves:g} waves from the second crest on, but only "
                        f"{one.seen:g} from the corner on, in all: did you count crests?"
                    )
        if bed_moves and modes["y"].hz > HEAVIER * modes["x"].hz:
            yield (
                "the bed rings faster in y than the head in x. Beds are heavier: did you exchange "
                "the rows of x and y?"
            )


def uncertainty(modes: Iterable[PrintedMode]) -> float:
    """Return the share by which the printer may differ from the modes."""
    return min(max(LEAST_UNCERTAINTY, *(2.0 * one.uncertainty for one in modes)), MOST_UNCERTAINTY)


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
    if not (valid and all(isinstance(one, int | float) and 0.0 <= one < 1e5 for one in row)):
        raise HframeError(f"{name} must be three numbers. {ROW}")
    one = Reading(band, *map(float, row))
    if (one.distance > 0.0) != (one.waves > 0.0):
        raise HframeError(
            f"{name} has a distance without waves, or waves without one. Write both, or [0, 0, "
            f"{one.seen:g}] if the waves are seen but cannot be measured"
        )
    return one
