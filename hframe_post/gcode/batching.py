"""Consecutive moves as one item with the lines between them, read many at once where possible."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from hframe_post.arrays import Array, E, lengths
from hframe_post.errors import GcodeError
from hframe_post.gcode import commands
from hframe_post.gcode.commands import Vocabulary
from hframe_post.gcode.curves import MAX_COORDINATE_MM
from hframe_post.gcode.lines import Lines
from hframe_post.gcode.state import ROUNDED_S, Extent, ReadOptions, State
from hframe_post.native.plain_lines import (
    APPLY,
    HARMLESS,
    LEAVE,
    SHOWS,
    SKIP,
    TELLS,
    name_table,
    plain_lines,
)
from hframe_post.stream.marks import NO_MARKS, Mark, Marks
from hframe_post.stream.types import (
    FileLimits,
    Handling,
    Item,
    MoveAtRest,
    Moves,
    Passthrough,
    Position,
    frozen,
)

MOVES_PER_ITEM = 4096
MARKS_AT_ONCE = 4096  # lines that pass
MIN_FEED_MM_S = 0.1 / 60.0  # mm/s, F0.1, the least that is written
MAX_MOVE_S = 4 * 3600.0  # s of a move; a longer one is a mistake, and would never end
MAX_MARK_BYTES = 1 << 21  # of lines between two moves that are carried without a stop
BYTES_PER_MARK = 200  # in addition to the text
MAX_FILAMENT_MM = 2e3  # mm of one move; loading takes less
MAX_FILAMENT_PER_PATH = 10.0  # mm/mm; Klipper refuses more than a quarter
MIN_PATH_MM = 1e-9  # mm; a curve may end where it begins, and squares of less may be 0


class PlainLines:
    """Reader of many plain lines at once.

    To the bit, it does what ``Reader`` does line by line. It stops before the first line that needs
    a closer look: see ``native.plain_lines``.
    """

    def __init__(self, source: Lines, state: State, options: ReadOptions) -> None:
        self._source, self._state, self._options = source, state, options
        bed = Extent(options.travel)
        low, high = (np.array(each) for each in (bed.smallest, bed.largest))
        for axis, edge in enumerate(state.endstops):
            low[axis], high[axis] = max(low[axis], edge[0]), min(high[axis], edge[1])
        self._edges = *low.tolist(), *high.tolist()
        self._names = _names(options.vocabulary)
        self._values, self._rules = np.empty(15), np.empty(21)
        self._rows = np.empty((MOVES_PER_ITEM, 8))
        self._marks, self._taken = np.empty((MARKS_AT_ONCE, 4), np.int64), np.zeros(4, np.int64)

    def take(self, items: ItemBuilder) -> tuple[int, bool]:
        """Read lines, change the state, and add to the items.

        Returns how many moves are among the lines, -1 for no line, and whether E has a new name.
        """
        state, source = self._state, self._source
        text, offset = source.upcoming()
        if not text:
            return -1, False
        clocks, values = self._options.clocks, self._values
        values[:] = (
            *state.position, *state.offset, state.feed, state.speed, state.acceleration,
            state.travel_acceleration, *clocks, items.passed,
        )  # fmt: skip
        self._rules[:] = self._present_rules()
        count = plain_lines(
            text, offset, source.number + 1, self._names, values, self._rules,
            self._rows[: items.free], self._marks, self._taken,
        )  # fmt: skip
        lines, size, passed, renamed = self._taken.tolist()
        if not lines:
            return -1, False
        source.skip(lines, size)
        start = state.position
        clocks[:] = values[12:14]
        x, y, z, e, *_, e_offset, state.feed, _ = values[:10].tolist()
        state.acceleration, state.travel_acceleration = values[10:12].tolist()
        if count:
            state.position = (x, y, z, e)
        if renamed:
            state.offset = (*state.offset[:3], e_offset)
        marks = Marks(self._marks[:passed].copy(), text).compact() if passed else NO_MARKS
        items.add_rows(start, self._rows[:count].copy(), marks, int(values[-1]))
        return count, bool(renamed)

    def _present_rules(self) -> tuple[float, ...]:
        state, limits, dialect = self._state, self._options.limits, self._options.dialect
        rules = [
            (APPLY if limits == "file-all" or name in dialect.obeyed else SKIP)
            if limits != "printer" else SKIP
            for name in ("M204", commands.LIMITS)
        ]  # fmt: skip
        if rules[0] == APPLY and state.others.travel < math.inf:
            rules[0] = LEAVE
        moves = state.absolute and state.e_mode_known and all(state.known)
        return (
            state.scale, state.factor, MIN_FEED_MM_S, MAX_COORDINATE_MM, MAX_FILAMENT_MM,
            *self._edges, not state.absolute_e, state.corner, 0.99 * MAX_FILAMENT_PER_PATH,
            MIN_PATH_MM, moves, *rules, MAX_MARK_BYTES, BYTES_PER_MARK, ROUNDED_S,
        )  # fmt: skip


def _names(vocabulary: Vocabulary) -> bytes:
    """Return the table of the commands that pass in mid-motion, and that nothing follows."""
    harmless = {
        name: HARMLESS
        for name, effect in vocabulary.names.items()
        if effect is commands.Effect.NONE and name not in commands.FOLLOWED
    }
    special = {"M73": TELLS, "M117": SHOWS, "M118": SHOWS}
    return name_table(harmless | {name: special[name] for name in special if name in harmless})


class ItemBuilder:
    """Collector of moves and the lines between them; finished items are in ``ready``."""

    def __init__(self, state: State) -> None:
        self._state = state
        self._start: Position = (0.0, 0.0, 0.0, 0.0)
        self._count = 0
        self._rows: list[tuple[float, ...]] = []  # the latest moves
        self._tables: list[Array] = []  # those before
        self._lines = list[Mark]()  # the latest that pass among the moves, or before the first
        self._marks = list[Marks]()  # those before
        self.passed = 0  # bytes since the last move or stop
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

    def add_rows(self, start: Position, rows: Array, marks: Marks, passed: int) -> None:
        """Add at most ``free`` rows and lines of ``PlainLines``. passed: bytes since the last."""
        if not self._count and marks:
            first = marks.count_before(1)
            self._add_marks(marks.rows(0, first))
            marks = marks.rows(first)
        if len(rows):
            self._begin(start)
            self._tabulate()
            self._tables.append(rows)
        self._add_marks(marks)
        self._count += len(rows)
        self.passed = passed
        if not self.free:
            self.flush()

    def _add_marks(self, marks: Marks) -> None:
        if self._lines:
            self._marks.append(Marks.from_lines(self._lines))
            self._lines = []
        if marks:
            self._marks.append(marks.shifted(self._count))

    def _begin(self, start: Position) -> None:
        if not self._count:
            self.flush()
            self._start = start
        self.passed, self.any_motion = 0, True

    def _tabulate(self) -> None:
        if self._rows:
            self._tables.append(np.array(self._rows))
            self._rows = []

    def add_move_at_rest(self, move: MoveAtRest) -> None:
        """Add a move while x and y are at rest. Raises GcodeError if it takes too long."""
        self.flush()
        length = max(abs(a - b) for a, b in zip(move.end, move.start, strict=True))
        _check_duration(length / move.speed, move.line)
        self.passed, self.any_motion = 0, True
        self.ready.append(move)

    def carry(self, text: bytes) -> bool:
        """Add a line that needs no stop; return False if there are too many in a row.

        Then one of them has to stop the machine: only so can later stages release from memory what
        came before it.
        """
        size = self.passed + len(text) + BYTES_PER_MARK
        if size > MAX_MARK_BYTES:
            return False
        self.passed = size
        self._lines.append(Mark(self._count, text))
        return True

    def add_line(self, item: Passthrough) -> None:
        """Add a line that must happen at rest, or the one too many that was to be carried."""
        self.passed += len(item.text) + BYTES_PER_MARK
        if self.passed > MAX_MARK_BYTES:
            item = replace(item, handling=Handling.RELEASE)
        if item.handling is Handling.RELEASE:
            self.passed = 0
        self.flush()
        self.ready.append(item)

    def flush(self, limits: FileLimits | None = None) -> None:
        """End the item that is collected. limits: of its moves; those in force by default."""
        self._add_marks(NO_MARKS)
        marks, self._marks = Marks.joined(self._marks), []
        if not self._count:
            if marks:
                self.ready.append(marks)
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
                limits or self._state.others, marks,
            )
        )  # fmt: skip
        self._count, self._tables = 0, []


def _check_duration(seconds: float, line: int) -> None:
    if seconds > MAX_MOVE_S:
        hours, most = seconds / 3600.0, MAX_MOVE_S / 3600.0
        raise GcodeError(
            f"this move would take {hours:.3g} h; at most {most:g} h are possible", line
        )
