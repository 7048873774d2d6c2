"""Moves that follow each other, gathered into one item with the lines between them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hframe_post.arrays import Array, E, Integers, lengths
from hframe_post.errors import GcodeError
from hframe_post.gcode.limits import RequestedLimits
from hframe_post.stream.types import (
    Handling,
    Item,
    Mark,
    Moves,
    Passthrough,
    Position,
    Standing,
    frozen,
)

MOVES_PER_ITEM = 4096
LONGEST_MOVE = 4 * 3600.0  # s; a move that takes longer is a mistake, and would never end
CARRIED_AT_ONCE = 1 << 21  # bytes of lines between two moves that are carried without a stop
ACCELERATION = 6  # column of gathered moves
PER_LINE = 200  # bytes that a carried line takes beside its text


class Gathering:
    """The moves gathered since the last item, and items that are ready in ``out``.

    any_motion: whether there has been a move since the start of the file.
    """

    def __init__(self, limits: RequestedLimits) -> None:
        self._limits = limits
        self._start: Position = (0.0, 0.0, 0.0, 0.0)
        self._count = 0
        self._rows: list[tuple[float, ...]] = []  # the last of them
        self._tables: list[Array] = []  # those before
        self._marks: list[Mark] = []
        self._carried = 0  # bytes since the last move or stop
        self.any_motion = False
        self.out: list[Item] = []

    @property
    def room(self) -> int:
        """How many moves more make an item."""
        return MOVES_PER_ITEM - self._count

    @property
    def limits(self) -> tuple[float, float]:
        """Acceleration and square-corner velocity that hold for the next moves."""
        return self._limits.acceleration, self._limits.corner

    def travel(self, number: int, start: Position, end: Position, speed: float) -> None:
        """A move in which x or y travels joins the gathered ones, under the present limits."""
        self._begin(start)
        self._count += 1
        limits = self._limits
        acceleration = limits.acceleration if end[E] != start[E] else limits.travel
        self._rows.append((number, *end, speed, acceleration, limits.corner))
        if not self.room:
            self.flush()

    def travels(self, start: Position, moves: Array) -> None:
        """Such moves (k, 8), no more than there is room for.

        Source line, x, y, z, e at the end, speed and ``limits`` of each.
        """
        self._begin(start)
        self._tabulate()
        if (travel := self._limits.travel) != self._limits.acceleration:
            moves[np.diff(moves[:, 1 + E], prepend=start[E]) == 0.0, ACCELERATION] = travel
        self._count += len(moves)
        self._tables.append(moves)
        if not self.room:
            self.flush()

    def _begin(self, start: Position) -> None:
        if not self._count:
            self._start = start
        self._carried, self.any_motion = 0, True

    def _tabulate(self) -> None:
        if self._rows:
            self._tables.append(np.array(self._rows))
            self._rows = []

    def stand(self, move: Standing) -> None:
        """A move in which x and y stand ends the gathered ones. Raises GcodeError."""
        self.flush()
        length = max(abs(a - b) for a, b in zip(move.end, move.start, strict=True))
        if length > LONGEST_MOVE * move.speed:
            raise _endless(length / move.speed, move.line)
        self._carried, self.any_motion = 0, True
        self.out.append(move)

    def pass_through(self, item: Passthrough) -> None:
        """A carried line among gathered moves is a mark; all others end the gathered moves.

        Where more lines follow each other than can be held, one of them has to stop the
        machine: only then does everything before it leave the memory of later stages.
        """
        self._carried += len(item.text) + PER_LINE
        if self._carried > CARRIED_AT_ONCE:
            item = replace(item, handling=Handling.RELEASE)
        if item.handling is Handling.CARRY and self._count:
            self._marks.append(Mark(self._count, item.text))
            return
        if item.handling is Handling.RELEASE:
            self._carried = 0
        self.flush()
        self.out.append(item)

    def flush(self) -> None:
        """The gathered moves become one item; the axis limits are those of now.

        Raises GcodeError where a move would take too long.
        """
        if not self._count:
            return
        self._tabulate()
        table = np.concatenate(self._tables)
        points = np.vstack([self._start, table[:, 1:5]])
        speed, acceleration, corner = (frozen(table[:, k].copy()) for k in (5, 6, 7))
        line = table[:, 0].astype(np.int64)
        _check_end(points, speed, line)
        self.out.append(
            Moves(
                line, frozen(points), speed, acceleration, corner, self._limits.axes,
                tuple(self._marks),
            )
        )  # fmt: skip
        self._count, self._tables, self._marks = 0, [], []


def _check_end(points: Array, speed: Array, line: Integers) -> None:
    seconds = lengths(np.diff(points[:, :E], axis=0)) / speed
    worst = int(seconds.argmax())
    if seconds[worst] > LONGEST_MOVE:
        raise _endless(float(seconds[worst]), int(line[worst]))


def _endless(seconds: float, number: int) -> GcodeError:
    hours, most = seconds / 3600.0, LONGEST_MOVE / 3600.0
    return GcodeError(f"this move would take {hours:.3g} h; at most {most:g} h can be", number)
