"""Lines of the file, and others without motion, as they stand between lines of motion."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from hframe_post.arrays import TS, Integers
from hframe_post.stream.marks import CLOCK, END, INDEX, KIND, OTHERS, SETS, START, Marks
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
        kinds = marks.table[:, KIND]
        table = np.empty((len(marks), 5), np.int64)
        table[:, ROW], table[:, BEGIN] = rows, marks.table[:, START]
        table[:, STOP], table[:, SAMPLE] = marks.table[:, END] + 1, marks.table[:, INDEX]
        table[:, TIME] = kinds == CLOCK
        text, added = marks.text, list[tuple[int, bytes]]()
        for k in np.flatnonzero(kinds >= SETS).tolist():
            line = text[table[k, BEGIN] : table[k, STOP] - 1]
            table[k, TIME] = kinds[k] == OTHERS and says_time(line)
            if modes_after is not None and line[:1] != b";" and (modes := modes_after(line)):
                added.append((k, modes))
        if not added:
            return cls(table, text)
        after = [k + 1 for k, _ in added]
        sizes = [len(modes) for _, modes in added]
        table = np.insert(table, after, table[[k for k, _ in added]], axis=0)
        new = np.array(after) + np.arange(len(after))
        table[new, STOP] = len(text) + np.cumsum(sizes)
        table[new, BEGIN] = table[new, STOP] - sizes
        table[new, TIME] = False
        return cls(table, text + b"".join(modes for _, modes in added))

    def with_lines(self, lines: Sequence[tuple[int, bytes]], first: bool = False) -> Between:
        """Return also other lines, each with its row; first: before those of the same row."""
        if not lines:
            return self
        rows, texts = zip(*lines, strict=True)
        stop = len(self.text) + np.cumsum([len(text) for text in texts])
        table = np.zeros((len(lines), 5), np.int64)
        table[:, ROW], table[:, STOP] = rows, stop
        table[:, BEGIN] = stop - [len(text) for text in texts]
        both = [table, self.table] if first else [self.table, table]
        joined = np.concatenate(both)
        order = joined[:, ROW].argsort(kind="stable")
        return Between(joined[order], self.text + b"".join(texts))

    def output(self) -> Output:
        """Return the lines alone."""
        starts, stops = self.table[:, BEGIN].tolist(), self.table[:, STOP].tolist()
        text = b"".join([self.text[a:b] for a, b in zip(starts, stops, strict=True)])
        sizes = self.table[:, STOP] - self.table[:, BEGIN]
        return self.deferred(text, np.cumsum(sizes) - sizes)

    def deferred(self, text: bytes, begun: Integers) -> Output:
        """Return a text in which the lines begin at these places, (m,)."""
        if not (of := np.flatnonzero(self.table[:, TIME])).size:
            return text
        table, start = self.table[of], begun[of]
        at = np.column_stack([start, start + table[:, STOP] - table[:, BEGIN] - 1])
        return Deferred(text, at, np.asarray(table[:, SAMPLE] * TS))


NOTHING_BETWEEN = Between(np.zeros((0, 5), np.int64), b"")


def text_of(lines: Iterable[bytes]) -> bytes:
    """Return lines as a text."""
    return b"".join(line + b"\n" for line in lines)
