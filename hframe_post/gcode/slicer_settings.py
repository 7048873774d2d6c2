"""What a slicer wrote into a file about the filament: how fast it melts and how fast it cools.

OrcaSlicer, Bambu Studio, SuperSlicer and PrusaSlicer write all settings as comments, ``; name =
value``, with a value for each filament. Cura writes those that differ from its defaults, as one
text in lines of 80 characters.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass

FLOW = b"filament_max_volumetric_speed", b"max_volumetric_speed", b"material_max_flowrate"
LAYER_TIME = b"slow_down_layer_time", b"slowdown_below_layer_time", b"cool_min_layer_time"
MIN_SPEED = b"slow_down_min_speed", b"min_print_speed", b"cool_min_speed"
_NAMES = b"|".join((*FLOW, *LAYER_TIME, *MIN_SPEED))
_COMMENT = re.compile(rb";\s*(" + _NAMES + rb")\s*=\s*([\d.,; ]+)")
_IN_CURA = re.compile(rb"n(" + _NAMES + rb") = (\d+(?:\.\d+)?)")
_CURA = b";SETTING_3 "


@dataclass(frozen=True, slots=True)
class SlicerSettings:
    """Limits of the filament; None: not said.

    flow: mm³/s that it melts. layer_time: least seconds of a layer. min_speed: mm/s, below which no
    layer is slowed for that.
    """

    flow: float | None = None
    layer_time: float | None = None
    min_speed: float | None = None


def is_setting(line: bytes) -> bool:
    """Return whether ``slicer_settings`` reads anything from this line."""
    return line.startswith(_CURA) or _COMMENT.match(line) is not None


def slicer_settings(lines: Iterable[bytes]) -> SlicerSettings:
    """Return what the comments of a file say; of several filaments, the most careful values."""
    found: dict[bytes, list[float]] = {}
    cura = list[bytes]()
    for line in lines:
        if line[:1] != b";":
            continue
        if match := _COMMENT.match(line):
            found.setdefault(match[1], []).extend(_positive(match[2]))
        elif line.startswith(_CURA):
            cura.append(line[len(_CURA) :].rstrip(b"\r\n"))
    for match in _IN_CURA.finditer(b"".join(cura)):
        found.setdefault(match[1], []).extend(_positive(match[2]))
    flows, times, speeds = (
        [value for name in names for value in found.get(name, ())]
        for names in (FLOW, LAYER_TIME, MIN_SPEED)
    )
    return SlicerSettings(
        min(flows, default=None), max(times, default=None), max(speeds, default=None)
    )


def _positive(text: bytes) -> list[float]:
    """Return the numbers above 0 of a list; 0 stands for no limit."""
    numbers = re.findall(rb"\d+(?:\.\d+)?", text)
    return [value for value in map(float, numbers) if 0.0 < value < 1e3]
