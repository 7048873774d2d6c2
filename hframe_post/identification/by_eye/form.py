"""The form in which the owner notes what the tower shows, and the plant that follows from it."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from hframe_post.errors import HframeError, IdentificationError
from hframe_post.identification.by_eye.tower import LAYER, LAYERS, SIDE
from hframe_post.identification.by_eye.waves import (
    SECOND_CREST,
    Band,
    PrintedMode,
    Reading,
    frequency,
    printed_mode,
)

WALLS = {"x": "right wall", "y": "back wall"}
LEAST_UNCERTAINTY, MOST_UNCERTAINTY = 0.1, 0.3  # second modes are not seen; a ruler reads no worse
MOST = 1e5  # of any number
USUAL_HZ = {"x": (25.0, 75.0), "y": (15.0, 70.0)}
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
        found = []
        for axis, rows in self.hertz().items():
            hz, (low, high) = modes[axis].hz, USUAL_HZ[axis]
            if not low <= hz <= high:
                found.append(
                    f"{hz:.0f} Hz in {axis}: usual is {low:g} to {high:g}. Measure again, if you "
                    "are not sure"
                )
            found += self._doubtful_rows(axis, rows, hz)
        if bed_moves and modes["y"].hz > HEAVIER * modes["x"].hz:
            found.append(
                "the bed rings faster in y than the head in x. Beds are heavier: did you exchange "
                "the rows of x and y?"
            )
        return found

    def _doubtful_rows(self, axis: str, rows: dict[str, float], hz: float) -> Iterator[str]:
        for k, one in enumerate(self.readings[axis], 1):
            name = f"{axis}{k}"
            if name in rows and abs(rows[name] / hz - 1.0) > APART:
                yield (
                    f"row {name} means {rows[name]:.0f} Hz and {axis} has {hz:.0f}: count its "
                    "waves again. Is it the row of another height?"
                )
            elif name in rows and one.seen < SECOND_CREST + one.waves:
                yield (
                    f"row {name} has {one.waves:g} waves from the second crest on, but only "
                    f"{one.seen:g} from the corner on: did you count crests?"
                )


def filled(text: str, source: str) -> Filled:
    """Return a filled form. Raises HframeError, which names the row."""
    try:
        document = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise HframeError(
            f"{source} is not a form of 'hframe-post calibrate-print': {error}. {ROW}"
        ) from None
    try:
        printed, waves = document["print"], document["waves"]
        pairs = zip(printed["speeds"], printed["corners"], strict=True)
        bands = [Band(float(speed), float(corner)) for speed, corner in pairs]
        if not isinstance(waves, dict):
            raise TypeError("waves is a table")
        acceleration = float(printed["acceleration"])
    except (ValueError, KeyError, TypeError) as error:
        raise HframeError(
            f"{source} is not a form of 'hframe-post calibrate-print': {error}"
        ) from None
    readings = {
        axis: [
            _reading(band, waves.get(f"{axis}{k}", [0, 0, 0]), f"{source}: {axis}{k}")
            for k, band in enumerate(bands, 1)
        ]
        for axis in WALLS
    }
    return Filled(readings, acceleration)


def _reading(band: Band, row: object, name: str) -> Reading:
    """Return a row of the form. Raises HframeError for what no ruler shows."""
    one = Reading(band, *_numbers(row, 3, f"{name} must be three numbers. {ROW}"))
    if (one.distance > 0.0) != (one.waves > 0.0):
        raise HframeError(
            f"{name} has a distance without waves, or waves without one. Write both, or [0, 0, "
            f"{one.seen:g}] if the waves are seen but cannot be measured"
        )
    if one.seen < one.waves:
        raise HframeError(
            f"{name}: {one.waves:g} waves were measured, but only {one.seen:g} seen. The third "
            "number counts all waves that you see; the first two begin with the second crest"
        )
    return one


def _numbers(row: object, count: int, message: str) -> list[float]:
    """Return a row of ``count`` numbers. Raises HframeError with the message otherwise."""
    if (
        not isinstance(row, list)
        or len(row) != count
        or not all(isinstance(one, int | float) and 0.0 <= one < MOST for one in row)
    ):
        raise HframeError(message)
    return [float(one) for one in row]
