"""Lines of G-code before they are text: lines of motion as rows of numbers, others between them."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hframe_post.arrays import TS, E, Integers, Z
from hframe_post.firmware.motion import Stroke
from hframe_post.native.digits import BEGINS, JUMPS, STANDS, motion_lines
from hframe_post.stream.marks import CLOCK, END, KIND, OTHERS, SETS, START, Marks
from hframe_post.stream.types import Dwell
from hframe_post.writers.decimation import Place, Units
from hframe_post.writers.print_time import Deferred, Output, says_time

BYTES_AT_ONCE = 1 << 16  # of a page that is long
BYTES_PER_ROW = 30
SECOND = round(1.0 / TS)  # samples
ROW, BEGIN, STOP, SAMPLE, TIME = range(5)  # columns of a table


@dataclass(frozen=True, slots=True)
class Between:
    """m lines between lines of motion, in order.

    table (m, 5): the line of motion that each precedes, where it begins and ends in ``text``, line
    feed included, the sample at which it is due, and whether it says the print's time.
    """

    table: Integers
    text: bytes

    @classmethod
    def from_marks(
        cls, marks: Marks, rows: Integers | int, modes_after: Callable[[bytes], bytes] | None
    ) -> Between:
        """Return lines of the file, and what restores the stream's modes after each.

        rows (k,), or one for all: the lines of motion. modes_after: None: nothing does.
        """
        begin, end, kinds = marks.table[0, START], marks.table[-1, END] + 1, marks.table[:, KIND]
        table = np.empty((len(marks), 5), np.int64)
        table[:, ROW], table[:, SAMPLE], table[:, TIME] = rows, marks.at, kinds == CLOCK
        table[:, BEGIN : STOP + 1] = marks.table[:, START : END + 1]
        table[:, BEGIN : STOP + 1] += (-begin, 1 - begin)
        text, parts, done = marks.text[begin:end], list[bytes](), 0
        added = np.zeros(len(marks), np.int64)  # bytes behind each line
        for k in np.flatnonzero(kinds >= SETS).tolist():
            line = text[table[k, BEGIN] : table[k, STOP] - 1]
            table[k, TIME] = kinds[k] == OTHERS and says_time(line)
            if modes_after is not None and line[:1] != b";" and (modes := modes_after(line)):
                parts += [text[done : table[k, STOP]], modes]
                added[k], done = len(modes), int(table[k, STOP])
        if parts:
            text, after = b"".join([*parts, text[done:]]), np.cumsum(added)
            table[:, BEGIN] += after - added
            table[:, STOP] += after
        return cls(table, text)

    @classmethod
    def joined(cls, parts: Iterable[tuple[int, Between | bytes]]) -> Between:
        """Return all lines, those of one row in this order, with their rows raised by a number."""
        tables, rows, texts, size = list[Integers](), list[tuple[int, ...]](), list[bytes](), 0
        for row, part in parts:
            if isinstance(part, bytes):
                rows.append((row, size, size + len(part), 0, 0))
                text = part
            else:
                if rows:
                    tables.append(np.array(rows))
                    rows = []
                tables.append(np.add(part.table, (row, size, size, 0, 0)))
                text = part.text
            texts.append(text)
            size += len(text)
        if rows:
            tables.append(np.array(rows))
        if not tables:
            return NOTHING_BETWEEN
        table = np.concatenate(tables)
        return cls(table[table[:, ROW].argsort(kind="stable")], b"".join(texts))

    def __bool__(self) -> bool:
        return len(self.table) > 0

    @property
    def places(self) -> Integers:
        """Return the rows, and where lines begin and end in the text, (m, 3)."""
        return self.table[:, : STOP + 1]

    def deferred(self, text: bytes, begun: Integers) -> Output:
        """Return a text in which the lines begin at these places, (m,)."""
        if not (of := np.flatnonzero(self.table[:, TIME])).size:
            return text
        table, start = self.table[of], begun[of]
        at = np.column_stack([start, start + table[:, STOP] - table[:, BEGIN] - 1])
        return Deferred(text, at, np.asarray(table[:, SAMPLE] * TS))


NOTHING_BETWEEN = Between(np.zeros((0, 5), np.int64), b"")


class PlacedMove(NamedTuple):
    """A retraction or a lift, from place to place; speed, acceleration: see ``MoveAtRest``."""

    dwell: Dwell
    speed: float
    acceleration: float
    lifts: bool
    start: Place
    end: Place


class Asked(NamedTuple):
    """The row of a retraction or a lift, and its F (1,)."""

    row: int
    lifts: bool
    feed: Integers


class Page:
    """Lines that are made into text together.

    F is written where it changes, and with every retraction and lift; where it is not known, as at
    the beginning, the next motion has x and y, too. lines: made into text so far; busiest: lines of
    motion in the busiest second of these.
    """

    def __init__(self, units: Units) -> None:
        self._units = units
        self._feed, self._known = 0, False  # F before the first row, and whether it is known now
        self._limits = dict[bool, bytes]()  # last limit of lifts, and that of retractions
        self._revert = b""  # takes back what a retraction or a lift has changed
        self._second, self._in_second = 0, 0  # the last second, and lines of motion in it so far
        self.lines = self.busiest = 0
        self._clear()

    def _clear(self) -> None:
        self._rows = self._bytes = 0
        self._at, self._feeds, self._due = (list[Integers]() for _ in range(3))
        self._kinds = list[tuple[int, int]]()  # rows that are not usual, and how
        self._others = list[tuple[int, Between | bytes]]()  # the row that each precedes

    @property
    def is_long(self) -> bool:
        return self._rows * BYTES_PER_ROW + self._bytes >= BYTES_AT_ONCE

    # ------------------------------------------------------------------ other lines

    def add_lines(self, lines: Between | bytes, row: int = 0) -> None:
        """Add other lines before a row of those that are added next."""
        if lines:
            self._others.append((self._rows + row, lines))
            self._bytes += len(lines if isinstance(lines, bytes) else lines.text)

    def add_limits(self, lines: bytes) -> None:
        """Add lines that change feed rate and limits."""
        self.add_lines(lines)
        self._known, self._revert = False, b""
        self._limits.clear()

    def finish(self) -> None:
        """Add, at the end, what takes back the last change."""
        self.add_lines(self._revert)

    # ------------------------------------------------------------------ motion

    def add_motion(
        self, at: Integers, feeds: Integers, due: Integers, between: Between,
        dwells: Iterable[tuple[int, bytes | None]],
    ) -> None:  # fmt: skip
        """Add segments between places at (k + 1, 4), with F (k,), and the lines among them.

        due (k,): the sample at which each is due; dwells: lines before some of them.
        """
        self._start(at[0])
        if not self._known:
            self._kinds.append((self._rows, BEGINS))
            self._known = True
        if self._revert:
            self.add_lines(self._revert, row=1)
            self._revert = b""
        self.add_lines(between)
        for row, line in dwells:
            self.add_lines(line or b"", row)
        self._add_rows(at[1:], feeds, due)

    def add_stroke(self, move: PlacedMove) -> Asked | None:
        """Add a retraction or a lift, whose speed follows; None: nothing moves."""
        start, end = move.start, move.end
        if (end[Z], end[E]) == (start[Z], start[E]):
            return None
        self._start(start)
        self._kinds.append((self._rows, STANDS))
        self._known = True
        asked = Asked(self._rows, move.lifts, np.array([1]))
        self._add_rows(np.array([end]), asked.feed, np.array([move.dwell.index]))
        return asked

    def ask(self, asked: Asked, stroke: Stroke) -> None:
        """Say how a retraction or a lift is made."""
        changes = b""
        if stroke.limit != self._limits.get(asked.lifts, b""):
            self._limits[asked.lifts] = changes = stroke.limit
        if stroke.after and not self._revert:
            changes += stroke.before
            self._revert = stroke.after
        self.add_lines(changes, asked.row - self._rows)
        asked.feed[0] = max(round(stroke.speed * self._units.per_feed), 1)  # F0 is none

    def _start(self, place: Integers | Place) -> None:
        if not self._at:
            self._at.append(np.array([place]))
        elif not self._known:
            self._kinds.append((self._rows, JUMPS))
            self._add_rows(np.array([place]), np.array([1]), np.zeros(0, np.int64))

    def _add_rows(self, at: Integers, feeds: Integers, due: Integers) -> None:
        self._at.append(at)
        self._feeds.append(feeds)
        self._due.append(due)
        self._rows += len(at)

    # ------------------------------------------------------------------ text

    def text(self) -> Output:
        """Remove the lines and return them as text."""
        others, feeds = Between.joined(self._others), np.zeros(0, np.int64)
        at, kinds = np.zeros((1, 4), np.int64), np.zeros(self._rows, np.uint8)
        if self._rows:
            at, feeds = np.concatenate(self._at), np.concatenate(self._feeds)
            rows, of = zip(*self._kinds, strict=True) if self._kinds else ((), ())
            kinds[list(rows)] = of
            self._count(np.concatenate(self._due))
        own = at, feeds, kinds, self._feed
        text, begun = motion_lines(*own, self._units.decimals, others.places, others.text)
        self._feed = int(feeds[-1]) if self._rows else self._feed
        self._clear()
        self.lines += text.count(b"\n")
        return others.deferred(text, begun)

    def _count(self, due: Integers) -> None:
        """Count lines by the second; due (k,): samples, ascending."""
        first, last = int(due[0]) // SECOND, int(due[-1]) // SECOND
        lines = np.diff(due.searchsorted(SECOND * np.arange(first, last + 2)))
        if first == self._second:
            lines[0] += self._in_second
        self._second, self._in_second = last, int(lines[-1])
        self.busiest = max(self.busiest, int(lines.max()))
