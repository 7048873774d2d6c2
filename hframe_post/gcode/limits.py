"""Limits that a file asks for as a whole: of motors that nobody stated, and of its filament."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import chain
from typing import Any

import numpy as np

from hframe_post.arrays import Z
from hframe_post.errors import GcodeError
from hframe_post.gcode import commands
from hframe_post.gcode.commands import Line, command, numbers_among, parameters
from hframe_post.gcode.state import LimitSource, ReadOptions, State
from hframe_post.native.planning import square_corner_velocity
from hframe_post.printer.settings import Printer

BYTES_AHEAD = 1 << 22  # slicers ask for all the accelerations that they use within some layers
MOST_KNOWN = 4096  # lines with limits whose effect is remembered: a file has few of them
LIMITS = (b"M201", b"M203", b"M204", b"M205", commands.LIMITS.encode())


def with_motors(
    lines: Iterable[bytes], printer: Printer, limits: LimitSource
) -> tuple[Iterable[bytes], Printer]:
    """Return the lines, and the printer with motors for the limits that they ask for.

    Only the first BYTES_AHEAD are read, at once. Limits of motors that the profile states stay.
    limits: see ``ReadOptions``.
    """
    if printer.motors == (stated := printer.motors.stated):
        return lines, printer
    rest, head, size = iter(lines), list[bytes](), 0
    while size < BYTES_AHEAD and (text := next(rest, None)) is not None:
        head.append(text)
        size += len(text)
    options = ReadOptions.from_printer(printer, limits)
    usual = printer.limits
    own = usual.velocity, usual.acceleration, usual.square_corner_velocity
    most = np.max([own, *_asked(head, options)], axis=0).tolist()
    motors = stated.completed(printer.kinematics, *most)
    return chain(head, rest), replace(printer, motors=motors)


def _asked(lines: Iterable[bytes], options: ReadOptions) -> Iterator[tuple[float, float, float]]:
    """Yield speed, acceleration and speed through a right angle, once for each change."""
    state = State(options.dialect, start=options.start)
    known = dict[tuple[Any, ...], tuple[Any, ...]]()  # a line and the limits before → those after
    for text in lines:
        if text.startswith(LIMITS) and options.limits != "printer":
            before = state.acceleration, state.travel_acceleration, state.corner, state.others
            at = (text, *before[:3], id(state.others))
            if (after := known.get(at)) is not None:
                *_, state.acceleration, state.travel_acceleration, state.corner, state.others = (
                    after
                )
                continue
            line = Line(0, text)
            with suppress(GcodeError):  # the reader raises it, with its line
                name, arguments = command(line) or (commands.LIMITS, b"")
                if options.limits == "file" and name not in options.dialect.obeyed:
                    continue
                if name == commands.LIMITS:
                    words = parameters(line, commands.LIMIT_PARAMETERS)
                else:
                    words = numbers_among(line, arguments, commands.LIMIT_WORDS[name])
                state.set_limits(line, name, words)
                if len(known) >= MOST_KNOWN:
                    known.clear()
                after = state.acceleration, state.travel_acceleration, state.corner, state.others
                known[at] = (*before, *after)  # keeps what the id names
                yield _in_force(state)


def _in_force(state: State) -> tuple[float, float, float]:
    others = state.others
    hardest = max(state.acceleration, state.travel_acceleration)
    acceleration = min(hardest, max(others.acceleration[:Z]))
    corner = min(state.corner, square_corner_velocity(others.deviation, acceleration))
    return min(others.path, max(others.velocity[:Z])), acceleration, corner


# ----------------------------------------------------------------------
# What a slicer wrote into a file about the filament: how fast it melts and how fast it cools.
#
# OrcaSlicer, Bambu Studio, SuperSlicer and PrusaSlicer write all settings as comments, ``; name =
# value``, with a value for each filament. Cura writes those that differ from its defaults, as one
# text in lines of 80 characters.

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
