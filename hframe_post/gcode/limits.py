"""Limits that a file asks for as a whole, of motors that nobody stated."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import replace
from itertools import chain
from typing import Any

import numpy as np

from hframe_post.arrays import Z
from hframe_post.errors import GcodeError
from hframe_post.gcode import commands
from hframe_post.gcode.commands import Line, command, limit_words
from hframe_post.gcode.state import LimitSource, ReadOptions, State
from hframe_post.native.planning import square_corner_velocity
from hframe_post.printer.settings import Printer

BYTES_AHEAD = 1 << 22  # slicers ask for all the accelerations that they use within some layers
LIMITS = re.compile(rb"^(?:M20[1345](?![\d.])|%b).*" % commands.LIMITS.encode(), re.MULTILINE)


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
    state = State(options)
    known = dict[tuple[Any, ...], tuple[Any, ...]]()  # a line and the limits before → those after
    for text in (found[0] for texts in lines for found in LIMITS.finditer(texts)):
        before = state.acceleration, state.travel_acceleration, state.corner, state.others
        at = (text, *before[:3], id(state.others))
        if (after := known.get(at)) is not None:
            *_, state.acceleration, state.travel_acceleration, state.corner, state.others = after
            continue
        line = Line(0, text)
        with suppress(GcodeError):  # the reader raises it, with its line
            name, arguments = command(line) or (commands.LIMITS, b"")
            if not options.obeys(name):
                continue
            state.set_limits(line, name, limit_words(line, name, arguments))
            if len(known) >= 4096:  # a file has few of them
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
