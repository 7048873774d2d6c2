"""Small prints in the dialects of many slicers, of tests/dialects.

Each is three layers of a square, short enough to follow by eye. They differ in what makes
conversion hard: headers, object labels, layer and feature comments, lifts, modes, wipe towers,
firmware commands, and the wording of print times.
"""

from dataclasses import dataclass
from pathlib import Path

LAYERS = 3
FOLDER = Path(__file__).with_name("dialects")


@dataclass(frozen=True)
class Slice:
    """A file, the macros named in the user's profile, and beginnings of lines with print times."""

    name: str
    harmless: tuple[str, ...] = ()
    returns: tuple[str, ...] = ()
    times: tuple[str, ...] = ()
    folder: Path = FOLDER

    @property
    def lines(self) -> list[bytes]:
        return (self.folder / f"{self.name}.gcode").read_bytes().splitlines(keepends=True)


SLICES = {
    each.name: each
    for each in (
        Slice("cura", times=(";TIME:", ";TIME_ELAPSED:")),
        Slice(
            "prusaslicer",
            harmless=("_ON_LAYER_CHANGE",),
            times=("; estimated printing time (", "M73 "),
        ),
        Slice(
            "orcaslicer",
            harmless=("_set_fan_speed_changing_layer",),
            returns=("TIMELAPSE_*",),
            times=("; model printing time:", "; estimated printing time", "M73 "),
        ),
        Slice("superslicer", times=("; estimated printing time", "M73 ")),
        Slice("bambu", times=("; model printing time", "M73 P")),
        Slice(
            "creality",
            harmless=("TIMELAPSE_TAKE_FRAME",),
            times=("; estimated printing time", ";TIME:"),
        ),
        Slice("ideamaker", times=(";Print Time:", ";REMAINING_TIME:")),
        Slice("simplify3d", times=(";   Build time:",)),
        Slice("kisslicer", times=("; Estimated Build Time",)),
        Slice("icesl", times=(";TIME:",)),
        Slice("kirimoto", times=("; --- print time:",)),
        Slice("reprapfirmware"),
        Slice("repetier"),
        Slice("smoothie", times=("; estimated printing time",)),
        Slice("sailfish", times=("M73 ",)),
        Slice("wipe_tower", times=("M73 ",)),
        Slice("flashprint"),
        Slice("hidden_relative"),
    )
}
