"""Lines of the file, and others without motion, as they stand between lines of motion."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from hframe_post.arrays import TS, Integers
from hframe_post.stream.marks import CLOCK, END, KIND, OTHERS, SETS, START, Marks
from hframe_post.writers.print_time import Deferred, Output, says_time

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
        text, parts, done = marks.text[begin:end], list[tuple[int, Between | bytes]](), 0
        for k in np.flatnonzero(kinds >= SETS).tolist():
            line = text[table[k, BEGIN] : table[k, STOP] - 1]
            table[k, TIME] = kinds[k] == OTHERS and says_time(line)
            if modes_after is not None and line[:1] != b";" and (modes := modes_after(line)):
                parts += [(0, cls(table[done : k + 1], text)), (int(table[k, ROW]), modes)]
                done = k + 1
        return cls.joined([*parts, (0, cls(table[done:], text))]) if parts else cls(table, text)

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
