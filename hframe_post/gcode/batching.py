"""Consecutive moves as one item with the lines between them, read many at once where possible."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from hframe_post.arrays import Array, E
from hframe_post.errors import GcodeError
from hframe_post.gcode import commands
from hframe_post.gcode.curves import MAX_COORDINATE_MM
from hframe_post.gcode.objects import Objects
from hframe_post.gcode.state import ReadOptions, State
from hframe_post.native.plain_lines import (
    APPLY,
    CHANGES,
    HARMLESS,
    LABELS,
    MODES,
    SHOWS,
    SKIP,
    TELLS,
    UNKNOWN,
    Known,
    digest,
    plain_lines,
)
from hframe_post.stream.features import PLACE_WORDS
from hframe_post.stream.marks import NO_MARKS, SETS, Mark, Marks
from hframe_post.stream.types import (
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
# of comments that need a closer look, and of comments and messages that later stages read
WORDS = commands.COMMENT_WORDS, PLACE_WORDS, commands.TIME_WORDS
CORNER = 7  # column of ``PlainLines``' rows


class PlainLines:
    """Reader of many plain lines at once.

    To the bit, it does what ``Reader`` does line by line. It stops before the first line that needs
    a closer look: see ``native.plain_lines``.
    """

    def __init__(self, state: State, objects: Objects, options: ReadOptions) -> None:
        self._source, self._known = objects.source, objects.known
        self._state, self._objects, self._options = state, objects, options
        low, high = (np.array(each) for each in (state.bed.smallest, state.bed.largest))
        for axis, edge in enumerate(state.endstops):
            low[axis], high[axis] = max(low[axis], edge[0]), min(high[axis], edge[1])
        self._edges = *low.tolist(), *high.tolist()
        self._values, self._rules = np.empty(19), np.empty(22)
        self._rows = np.empty((MOVES_PER_ITEM, 8))
        self._marks, self._taken = np.empty((MARKS_AT_ONCE, 4), np.int64), np.zeros(6, np.int64)

    def take(self, items: ItemBuilder) -> bool:
        """Read lines, change the state, and add to the items; return whether to read on."""
        state, objects, source = self._state, self._objects, self._source
        text, offset = source.upcoming()
        if not text:
            return False
        kept = state.modes().items()
        self._known.classify({name: MODES if set_ else UNKNOWN for name, set_ in kept})
        values = self._values
        values[:] = (
            *state.position, *state.offset, state.feed, state.speed, state.acceleration,
            state.travel_acceleration, state.corner, items.passed, objects.present, objects.last,
            state.setting, state.others.cruise_ratio, state.others.path,
        )  # fmt: skip
        self._rules[:] = self._present_rules()
        count = plain_lines(
            text, offset, source.number + 1, self._known, WORDS, values, self._rules,
            self._rows[: items.free], self._marks, self._taken,
        )  # fmt: skip
        lines, size, passed, renamed, sets, stopped = self._taken.tolist()
        if not lines:
            return False
        source.skip(lines, size)
        start = state.position
        *_, e_offset, state.feed, _ = values[:10].tolist()
        state.acceleration, state.travel_acceleration, state.corner = values[10:13].tolist()
        objects.present, objects.last, state.setting = map(int, values[14:17].tolist())
        if renamed:
            state.offset, state.e_named = (*state.offset[:3], e_offset), True
        marks = Marks(self._marks[:passed].copy(), text).compact() if passed else NO_MARKS
        if sets:
            self._set_advance(marks)
        rows = self._rows[:count].copy()
        if count:
            x, y, z, e = values[:4].tolist()
            state.position = (x, y, z, e)
        items.add_rows(start, rows, marks, int(values[13]))
        ratio, path = values[17:].tolist()
        state.limit(cruise_ratio=ratio, path=path)
        return not stopped

    def _set_advance(self, marks: Marks) -> None:
        """Apply lines, and let the loop know the last again, unless the stream has to answer it."""
        for text in (line.text for line in marks.of(SETS)):
            change = self._state.set_advance(text)
        if change.smooth_time is None:
            self._known.learn(text, digest(text))

    def _present_rules(self) -> tuple[float, ...]:
        state, options = self._state, self._options
        m204, m205, velocity_limit = (
            APPLY if options.obeys(name) else SKIP for name in ("M204", "M205", commands.LIMITS)
        )
        if options.dialect.has_deviation:
            m205 = SKIP
        moves = state.absolute and state.e_mode_known and all(state.known)
        return (
            state.scale, state.factor, MIN_FEED_MM_S, MAX_COORDINATE_MM, MAX_FILAMENT_MM,
            *self._edges, not state.absolute_e, 0.99 * MAX_FILAMENT_PER_PATH, MIN_PATH_MM,
            MAX_MOVE_S, moves, m204, m205, velocity_limit, MAX_MARK_BYTES,
            BYTES_PER_MARK, self._objects.may_be_several,
        )  # fmt: skip


def known_names(options: ReadOptions) -> Known:
    """Return the classes of the commands that pass in mid-motion, and that no item depends on."""
    names = options.vocabulary.names.items()
    passing = [name for name, effect in names if effect is commands.Effect.NONE]
    followed = commands.FOLLOWED
    if options.retraction is not None:
        followed |= options.dialect.retraction_settings
    classes = {name: HARMLESS for name in passing if name not in followed}
    special = {"M73": TELLS, "M117": SHOWS, "M118": SHOWS}
    special |= {"SET_PRESSURE_ADVANCE": CHANGES, "M900": CHANGES}
    special |= dict.fromkeys(("M486", "EXCLUDE_OBJECT_START", "EXCLUDE_OBJECT_END"), LABELS)
    return Known(classes | {name: special[name] for name in special if name in passing})


class ItemBuilder:
    """Collector of moves and the lines between them; finished items are in ``ready``."""

    def __init__(self, state: State) -> None:
        self._state = state
        self._start: Position = (0.0, 0.0, 0.0, 0.0)
        self._limits = state.others  # of the moves
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
        _check_duration(math.dist(start[:E], end[:E]) / speed, number)
        self._begin(start)
        self._count += 1
        state = self._state
        extrudes = end[E] != start[E]
        acceleration = state.acceleration if extrudes else state.travel_acceleration
        self._rows.append((number, *end, speed, acceleration, state.corner))
        if not self.free:
            self.flush()

    def add_rows(self, start: Position, rows: Array, marks: Marks, passed: int) -> None:
        """Add at most ``free`` rows and lines of ``PlainLines``.

        passed: bytes since the last move.
        """
        stand, at, done = np.flatnonzero(rows[:, CORNER] < 0.0), 0, 0
        before = marks.at.searchsorted(stand, "right").tolist()
        for k, passed_by in zip(stand.tolist(), before, strict=True):
            own = marks.rows(done, passed_by).shifted(-at) if done < passed_by else NO_MARKS
            self._add_travel(start, rows[at:k], own)
            at, done = k + 1, passed_by
            if k > 0:
                start = tuple(rows[k - 1, 1:5].tolist())
            number, *end, speed, acceleration, _ = rows[k].tolist()
            self.stand(int(number), start, tuple(end), speed, acceleration)
            start = tuple(end)
        own = marks.rows(done).shifted(-at) if done < len(marks) else NO_MARKS
        self._add_travel(start, rows[at:], own)
        self.passed = passed
        if not self.free:
            self.flush()

    def _add_travel(self, start: Position, rows: Array, marks: Marks) -> None:
        if marks is not NO_MARKS and self._is_new:
            first = marks.count_before(1)
            self._add_marks(marks.rows(0, first))
            marks = marks.rows(first)
        if n := len(rows):
            self._begin(start)
            self._tabulate()
            self._tables.append(rows)
        if marks is not NO_MARKS:
            self._add_marks(marks)
        self._count += n

    def _add_marks(self, marks: Marks) -> None:
        if self._lines:
            self._marks.append(Marks.from_lines(self._lines))
            self._lines = []
        if marks:
            self._marks.append(marks.shifted(self._count))

    @property
    def _is_new(self) -> bool:
        """Return whether the next move begins an item: all moves of one have the same limits."""
        others = self._state.others
        return not self._count or (others is not self._limits and others != self._limits)

    def _begin(self, start: Position) -> None:
        if self._is_new:
            self.flush()
            self._start, self._limits = start, self._state.others
        self.passed, self.any_motion = 0, True

    def _tabulate(self) -> None:
        if self._rows:
            self._tables.append(np.array(self._rows))
            self._rows = []

    def stand(
        self, number: int, start: Position, end: Position, speed: float, acceleration: float
    ) -> None:
        """Add a move while x and y are at rest. Raises GcodeError if it takes too long."""
        limits = self._state.others.at_rest(start, end, speed, acceleration)
        self.flush()
        length = max(abs(end[2] - start[2]), abs(end[E] - start[E]))
        _check_duration(length / limits[0], number)
        self.passed, self.any_motion = 0, True
        self.ready.append(MoveAtRest(number, start, end, *limits))

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

    def flush(self) -> None:
        """End the item that is collected."""
        marks = NO_MARKS
        if self._lines:
            self._add_marks(NO_MARKS)
        if self._marks:
            marks, self._marks = Marks.joined(self._marks), []
        if not self._count:
            if marks:
                self.ready.append(marks)
            return
        self._tabulate()
        points = np.empty((self._count + 1, 4))
        points[0] = self._start
        table = np.concatenate(self._tables) if len(self._tables) > 1 else self._tables[0]
        points[1:] = table[:, 1:5]
        speed, acceleration, corner = frozen(table[:, 5:].T.copy())
        self.ready.append(
            Moves(
                table[:, 0].astype(np.int64), frozen(points), speed, acceleration, corner,
                self._limits, marks,
            )
        )  # fmt: skip
        self._count, self._tables = 0, []


def _check_duration(seconds: float, line: int) -> None:
    if seconds > MAX_MOVE_S:
        hours, most = seconds / 3600.0, MAX_MOVE_S / 3600.0
        raise GcodeError(
            f"this move would take {hours:.3g} h; at most {most:g} h are possible", line
        )
