"""The motion of a G-code file in nominal time, cut at every line that is not a move.

Nominal time is length over feed rate. Firmware's ramps are left out: they are alike in all files,
except inside a stream of this tool. There they depend on how motion was cut into segments, and its
feed rates allow for them; so there they count, with the limits that the stream itself sets.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from hframe_post.arrays import Array, E, Integers, Z, lengths
from hframe_post.errors import GcodeError
from hframe_post.firmware.dialect import Dialect
from hframe_post.gcode.batching import MOVES_PER_ITEM, PlainMoves
from hframe_post.gcode.commands import (
    LIMIT_PARAMETERS,
    LIMITS,
    MODAL,
    MOTION_WORDS,
    STAMP,
    Line,
    Words,
    command,
    numbers,
    parameters,
)
from hframe_post.gcode.curves import curve
from hframe_post.gcode.lines import Lines
from hframe_post.gcode.state import Extent, State
from hframe_post.native import ramps
from hframe_post.native.planning import junction_deviation, junction_speeds
from hframe_post.stream.types import frozen
from hframe_post.writers.print_time import SUMMARY

EXTRUDER_CORNER_VELOCITY = 1.0  # mm/s, Klipper's default; no file sets it


@dataclass(frozen=True, slots=True)
class MoveSection:
    """n consecutive moves, and the line that ends them.

    line (n,): source lines. time (n + 1,): from the section's start, s, ascending. xyze
    (n + 1, 4): positions, mm; e is all filament since the start of the file. closing: the line
    after them; None at the end of the file.
    """

    line: Integers
    time: Array
    xyze: Array
    closing: Line | None


def sections(lines: Iterable[bytes], dialect: Dialect) -> Iterator[MoveSection]:
    """Yield the file in sections, streaming. Raises GcodeError.

    A dwell (G4) counts as motion that stays in place: its length depends on how motion was cut.
    Comments behind moves are left out, and so are the stamp and the summary of this tool.
    """
    source = Lines(lines, dialect.cr_ends_lines)
    reader = _MotionReader(source, dialect)
    for line in source:
        if b"\0" in line.text:
            raise GcodeError("this is not a text file", line.number)
        moves = reader.apply(line)
        if not (moves or line.text.startswith((STAMP, SUMMARY.line))):
            yield reader.section(line._replace(text=line.text.rstrip()))
        reader.apply_plain_moves()
    yield reader.section(None)


class _MotionReader:
    """Interpreter of lines: each one changes ``state``, and its motion goes to ``rows``."""

    def __init__(self, source: Lines, dialect: Dialect) -> None:
        self._dialect = dialect
        self._state = State(dialect, "absolute")
        self._state.known = [True, True, True]  # both files treat an unhomed machine alike
        self._plain_moves = PlainMoves(source, self._state, Extent(None))
        self._limits: Words = {}  # by SET_VELOCITY_LIMIT so far
        self._begin()

    def _begin(self) -> None:
        self._time = 0.0
        self._rows = array("d", (0.0, 0.0, *self._state.position))  # line, time, x, y, z, e

    def apply_plain_moves(self) -> None:
        start = self._state.position
        while (moves := self._plain_moves.take(MOVES_PER_ITEM)) is not None:
            if len(moves):
                points = np.vstack([start, moves[:, 1:5]])
                seconds = lengths(np.diff(points[:, :E], axis=0)) / moves[:, 5]
                time = np.cumsum(np.concatenate([[self._time], seconds]))[1:]
                rows = np.column_stack([moves[:, 0], time, moves[:, 1:5]])
                self._rows.frombytes(rows.tobytes())
                self._time, start = float(time[-1]), self._state.position

    def apply(self, line: Line) -> bool:
        """Apply a line; return whether it is a move or a dwell."""
        coded = command(line)
        if coded is None:
            return False
        name, arguments = coded
        state = self._state
        if name in MOTION_WORDS:
            return self._apply_motion(line, name, numbers(line, arguments, MOTION_WORDS[name]))
        if name == "G4":
            self._go(line, state.position, self._dialect.dwell(numbers(line, arguments, "PS")))
            return True
        if name in MODAL:
            state.set_mode(name)
        elif name == "G28":
            state.home(arguments)
        return False

    def _apply_motion(self, line: Line, name: str, words: Words) -> bool:
        state = self._state
        if "F" in words:
            state.set_feed(line, words.pop("F"))
        if name == "G92":
            state.rename_position(line, words)
            return False
        end = state.target(words)
        points = [end]
        if name not in ("G0", "G1"):
            try:
                points = [
                    (x, y, z, e) for x, y, z, e in curve(line, name, words, state, end).tolist()
                ]
            except GcodeError:  # an arc that does not fit the point it starts from
                state.position = end
                return False
        for point in points:
            start = state.position
            length = math.dist(start[:3], point[:3]) or abs(point[3] - start[3])
            if not length < math.inf:
                raise line.error("a coordinate is too large")
            self._go(line, point, length / state.feed)
        return True

    def _go(self, line: Line, end: tuple[float, float, float, float], seconds: float) -> None:
        if seconds > 0.0:
            self._time += seconds
            self._rows.extend((line.number, self._time, *end))
            self._state.position = end

    def section(self, closing: Line | None) -> MoveSection:
        """Return the motion so far, ended by this line, and begin a new section."""
        table = np.array(self._rows).reshape(-1, 6)
        time, points = table[:, 1].copy(), frozen(table[:, 2:].copy())
        if self._in_stream and len(time) > 1:
            time[1:] = np.cumsum(self._with_ramps(np.diff(points, axis=0), np.diff(time)))
        if closing is not None and closing.text.upper().startswith(LIMITS.encode()):
            self._limits |= parameters(closing, LIMIT_PARAMETERS)
        self._begin()
        return MoveSection(table[1:, 0].astype(np.int64), frozen(time), points, closing)

    @property
    def _in_stream(self) -> bool:
        """Return whether a stream has set the limits: only it asks for a cruise ratio of 0."""
        known = {"ACCEL", "SQUARE_CORNER_VELOCITY"} <= self._limits.keys()
        return known and self._limits.get("MINIMUM_CRUISE_RATIO") == 0.0

    def _with_ramps(self, delta: Array, nominal: Array) -> Array:
        """Return the time (n,) in s of moves delta (n, 4), given their nominal time.

        The line that ends a section need not stop motion. Where it does, moves next to it are slow.
        """
        a = np.full(len(delta), self._limits["ACCEL"])
        d = lengths(delta[:, :E])
        moves = (delta[:, :Z] != 0.0).any(axis=1)
        d = np.where(moves, d, 1.0)  # mm, any length
        deviation = junction_deviation(self._limits["SQUARE_CORNER_VELOCITY"], a[0])
        inner = junction_speeds(delta, d, a, deviation, EXTRUDER_CORNER_VELOCITY)
        inside = np.where(moves[1:] & moves[:-1], inner, 0.0)
        caps = np.concatenate([[math.inf], inside, [math.inf]])
        taken = ramps.durations(d, d / nominal, a, caps, math.inf)
        return np.where(moves, taken, nominal)
