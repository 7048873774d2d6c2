"""Consecutive moves as one item with the lines between them, read many at once where possible."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hframe_post.arrays import Array, E, lengths
from hframe_post.errors import GcodeError
from hframe_post.gcode.curves import MAX_COORDINATE_MM
from hframe_post.gcode.lines import Lines
from hframe_post.gcode.state import Extent, State
from hframe_post.native.digits import plain_moves
from hframe_post.stream.types import (
    FileLimits,
    Handling,
    Item,
    Mark,
    MoveAtRest,
    Moves,
    Passthrough,
    Position,
    frozen,
)

MOVES_PER_ITEM = 4096
MIN_FEED_MM_S = 0.1 / 60.0  # mm/s, F0.1, the least that is written
MAX_MOVE_S = 4 * 3600.0  # s of a move; a longer one is a mistake, and would never end
MAX_MARK_BYTES = 1 << 21  # of lines between two moves that are carried without a stop
BYTES_PER_MARK = 200  # in addition to the text
MAX_FILAMENT_MM = 2e3  # mm of one move; loading takes less
MAX_FILAMENT_PER_PATH = 10.0  # mm/mm; Klipper refuses more than a quarter
MIN_PATH_MM = 1e-9  # mm; a curve may end where it begins, and squares of less may be 0


class PlainMoves:
    """Reader of many plain moves at once.

    To the bit, it does what ``Reader`` does line by line. It stops before the first line that is
    not a plain G0 or G1 in which x or y changes, or that needs a closer look: too far, too slow,
    off the bed, too much filament for its path, a number with many digits.
    """

    def __init__(self, source: Lines, state: State, bed: Extent) -> None:
        self._source, self._state = source, state
        low, high = (np.array(each) for each in (bed.smallest, bed.largest))
        for axis, edge in enumerate(state.endstops):
            low[axis], high[axis] = max(low[axis], edge[0]), min(high[axis], edge[1])
        self._edges = *low.tolist(), *high.tolist()
        self._values, self._rules = np.empty(10), np.empty(16)
        self._rows, self._taken = np.empty((MOVES_PER_ITEM, 8)), np.empty(2, dtype=np.int64)

    def take(self, most: int) -> Array | None:
        """Read moves and change the state; return a row for each of at most ``most`` moves (k, 8).

        A row: source line; x, y, z, e at the end; speed, acceleration, corner velocity. The result
        is None where the next line is not a plain move.
        """
        state, source = self._state, self._source
        if not (state.absolute and state.e_mode_known and all(state.known)):
            return None
        text, offset = source.upcoming()
        if not text.startswith((b"G1 ", b"G0 "), offset):
            return None
        self._values[:] = (*state.position, *state.offset, state.feed, state.speed)
        self._rules[:] = (
            state.scale, state.factor, MIN_FEED_MM_S, MAX_COORDINATE_MM, MAX_FILAMENT_MM,
            *self._edges, not state.absolute_e, state.acceleration, state.corner,
            0.99 * MAX_FILAMENT_PER_PATH, MIN_PATH_MM,
        )  # fmt: skip
        count = plain_moves(
            text, offset, source.number + 1, most,
            self._values, self._rules, self._rows, self._taken,
        )  # fmt: skip
        lines, size = self._taken.tolist()
        source.skip(lines, size)
        x, y, z, e, *_, state.feed, _ = self._values.tolist()
        if count:
            state.position = (x, y, z, e)
        return self._rows[:count].copy() if lines else None


class ItemBuilder:
    """Collector of moves and the lines between them; finished items are in ``ready``."""

    def __init__(self, state: State) -> None:
        self._state = state
        self._start: Position = (0.0, 0.0, 0.0, 0.0)
        self._count = 0
        self._rows: list[tuple[float, ...]] = []  # the latest moves
        self._tables: list[Array] = []  # those before
        self._marks: list[Mark] = []
        self._mark_bytes = 0  # since the last move or stop
        self.any_motion = False
        self.ready: list[Item] = []

    @property
    def free(self) -> int:
        return MOVES_PER_ITEM - self._count

    def add_move(self, number: int, start: Position, end: Position, speed: float) -> None:
        self._begin(start)
        self._count += 1
        state = self._state
        extrudes = end[E] != start[E]
        acceleration = state.acceleration if extrudes else state.travel_acceleration
        self._rows.append((number, *end, speed, acceleration, state.corner))
        if not self.free:
            self.flush()

    def add_rows(self, start: Position, rows: Array) -> None:
        """Add at most ``free`` rows of ``PlainMoves.take``."""
        if not len(rows):
            return
        self._begin(start)
        self._tabulate()
        if (travel := self._state.travel_acceleration) != self._state.acceleration:
            rows[np.diff(rows[:, 1 + E], prepend=start[E]) == 0.0, 6] = travel
        self._count += len(rows)
        self._tables.append(rows)
        if not self.free:
            self.flush()

    def _begin(self, start: Position) -> None:
        if not self._count:
            self._start = start
        self._mark_bytes, self.any_motion = 0, True

    def _tabulate(self) -> None:
        if self._rows:
            self._tables.append(np.array(self._rows))
            self._rows = []

    def add_move_at_rest(self, move: MoveAtRest) -> None:
        """Add a move while x and y are at rest. Raises GcodeError if it takes too long."""
        self.flush()
        length = max(abs(a - b) for a, b in zip(move.end, move.start, strict=True))
        _check_duration(length / move.speed, move.line)
        self._mark_bytes, self.any_motion = 0, True
        self.ready.append(move)

    def carry(self, text: bytes) -> bool:
        """Add a carried line as a mark among moves; return False if it must be an item."""
        size = self._mark_bytes + len(text) + BYTES_PER_MARK
        if not self._count or size > MAX_MARK_BYTES:
            return False
        self._mark_bytes = size
        self._marks.append(Mark(self._count, text))
        return True

    def add_line(self, item: Passthrough) -> None:
        """Add a line as an item.

        Where too many carried lines follow each other, one of them has to stop the machine: only
        then can later stages release from memory what came before it.
        """
        self._mark_bytes += len(item.text) + BYTES_PER_MARK
        if self._mark_bytes > MAX_MARK_BYTES:
            item = replace(item, handling=Handling.RELEASE)
        if item.handling is Handling.RELEASE:
            self._mark_bytes = 0
        self.flush()
        self.ready.append(item)

    def flush(self, limits: FileLimits | None = None) -> None:
        """End the item that is collected. limits: of its moves; those in force by default."""
        if not self._count:
            return
        self._tabulate()
        table = np.concatenate(self._tables)
        points = np.vstack([self._start, table[:, 1:5]])
        speed, acceleration, corner = (frozen(table[:, k].copy()) for k in (5, 6, 7))
        line = table[:, 0].astype(np.int64)
        seconds = lengths(points[1:, :E] - points[:-1, :E]) / speed
        _check_duration(float(seconds.max()), int(line[seconds.argmax()]))
        self.ready.append(
            Moves(
                line, frozen(points), speed, acceleration, corner,
                limits or self._state.others, tuple(self._marks),
            )
        )  # fmt: skip
        self._count, self._tables, self._marks = 0, [], []


def _check_duration(seconds: float, line: int) -> None:
    if seconds > MAX_MOVE_S:
        hours, most = seconds / 3600.0, MAX_MOVE_S / 3600.0
        raise GcodeError(
            f"this move would take {hours:.3g} h; at most {most:g} h are possible", line
        )
