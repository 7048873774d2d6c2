"""The form in which the owner notes what the tower shows, and the plant that follows from it."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass

from hframe_post.errors import HframeError, IdentificationError
from hframe_post.identification.by_eye.tower import LAYER, LAYERS, SIDE
from hframe_post.identification.by_eye.waves import Band, PrintedMode, Reading, printed_mode

WALLS = {"x": "right wall", "y": "back wall"}
LEAST_UNCERTAINTY, MOST_UNCERTAINTY = 0.1, 0.3  # second modes are not seen; a ruler reads no worse
HEAD = """\
# What the tower shows. Hold it so that light falls along a wall, and look at the waves behind the
# corner, beginning with the second: mm from crest to crest with a ruler, over how many waves that
# is, and how many waves are seen before they fade. Take as many as you can see. Leave a row of
# zeros where you see none.
"""


def form(bands: Sequence[Band], acceleration: float) -> str:
    """Return an empty form for a tower with these bands, printed with mm/s²."""
    rows = [f"{HEAD}", "[print]", f"acceleration = {acceleration:g}"]
    rows += [f"speeds = {[band.speed for band in bands]}"]
    rows += [f"corners = {[round(band.corner, 3) for band in bands]}", "", "[waves]"]
    for axis, wall in WALLS.items():
        for k, band in enumerate(bands):
            low, high = k * LAYERS * LAYER, (k + 1) * LAYERS * LAYER
            where = f"{wall}, {low:g} to {high:g} mm up, {band.speed:g} mm/s"
            rows.append(f"{axis}{k + 1} = [0, 0, 0]".ljust(28) + f"# {where}: mm, over waves, seen")
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


def filled(text: str, source: str) -> Filled:
    """Return a filled form. Raises HframeError, which names the row."""
    try:
        document = tomllib.loads(text)
        printed, waves = document["print"], document["waves"]
        speeds, corners = printed["speeds"], printed["corners"]
        bands = [Band(float(v), float(c)) for v, c in zip(speeds, corners, strict=True)]
        acceleration = float(printed["acceleration"])
    except (ValueError, KeyError, TypeError) as error:
        raise HframeError(
            f"{source} is not a form of 'hframe-post calibrate-print': {error}"
        ) from None
    readings = {
        axis: [_reading(waves, f"{axis}{k}", band, source) for k, band in enumerate(bands, 1)]
        for axis in WALLS
    }
    return Filled(readings, acceleration)


def _reading(waves: dict[str, object], name: str, band: Band, source: str) -> Reading:
    row = waves.get(name, [0, 0, 0])
    if (
        not isinstance(row, list)
        or len(row) != 3
        or not all(isinstance(one, int | float) and 0.0 <= one < 1e3 for one in row)
    ):
        raise HframeError(f"{source}: {name} must be three numbers: mm, over how many waves, seen")
    return Reading(band, *(float(one) for one in row))
