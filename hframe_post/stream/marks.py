"""Lines that pass through without a stop: many of them in one table, each at its place."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import lru_cache, wraps
from itertools import accumulate
from typing import NamedTuple, TypeVar

import numpy as np

from hframe_post.arrays import Integers

INDEX, START, END, KIND = range(4)  # columns of a table
# kinds of lines: those of which no stage needs to know more; those that tell the time left; those
# that name a layer or feature; those that set pressure advance; those that change nothing for later
# stages, but what the stream has set; others, which may do any of that
PLAIN, CLOCK, PLACES, SETS, RESETS, OTHERS = range(6)

T = TypeVar("T")


def recent(read: Callable[[bytes], T]) -> Callable[[bytes], T]:
    """Return a function of a line that keeps its results: several stages read it, and lines recur.

    Long lines are not kept: a file of them would fill the memory.
    """
    kept = lru_cache(256)(read)

    @wraps(read)
    def known(text: bytes) -> T:
        return kept(text) if len(text) <= 100 else read(text)

    return known


class Mark(NamedTuple):
    """A line that passes through without a stop, before the move or the sample ``index``."""

    index: int  # type: ignore[assignment]  # it has no use for the method of tuples
    text: bytes


@dataclass(frozen=True, slots=True, eq=False)
class Marks:
    """k lines that pass through without a stop, in the order of the file.

    table (k, 4): the move or the sample that each precedes, where it begins and ends in ``text``
    (before its line feed), and its kind. Parts of the lines share the text.
    """

    table: Integers
    text: bytes

    @classmethod
    def from_lines(cls, marks: Iterable[Mark], kind: int = OTHERS) -> Marks:
        """Return lines of one kind."""
        marks = tuple(marks)
        ends = [*accumulate(len(mark.text) + 1 for mark in marks)]
        rows = [
            (mark.index, end - len(mark.text) - 1, end - 1, kind)
            for mark, end in zip(marks, ends, strict=True)
        ]
        text = b"".join(mark.text + b"\n" for mark in marks)
        return cls(np.array(rows, np.int64).reshape(-1, 4), text)

    @classmethod
    def joined(cls, parts: Iterable[Marks]) -> Marks:
        """Return the lines of all parts, one after the other."""
        parts = [part for part in parts if len(part.table)]
        if len(parts) <= 1:
            return parts[0] if parts else NO_MARKS
        tables, texts, size = list[Integers](), list[bytes](), 0
        for part in parts:
            first, end = int(part.table[0, START]), int(part.table[-1, END]) + 1
            texts.append(part.text[first:end])
            table = part.table.copy()
            table[:, START : END + 1] += size - first
            tables.append(table)
            size += end - first
        return cls(np.concatenate(tables), b"".join(texts))

    def __len__(self) -> int:
        return len(self.table)

    def __iter__(self) -> Iterator[Mark]:
        for index, start, end, _ in self.table.tolist():
            yield Mark(index, self.text[start:end])

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Marks) and tuple(self) == tuple(other)

    def __hash__(self) -> int:
        return hash(tuple(self))

    @property
    def at(self) -> Integers:
        """Return the index of each line, (k,)."""
        return self.table[:, INDEX]

    @property
    def index(self) -> int:
        """Return the index of the first line."""
        return int(self.table[0, INDEX])

    @property
    def last(self) -> int:
        """Return the index of the last line."""
        return int(self.table[-1, INDEX])

    def of(self, kind: int) -> Iterator[Mark]:
        """Yield the lines that may be of a kind."""
        table = self.table
        if len(table) > 16:  # Python finds shorter tables faster than numpy
            kinds = table[:, KIND]
            table = table[(kinds == kind) | (kinds == OTHERS)]
        for index, start, end, own in table.tolist():
            if own in (kind, OTHERS):
                yield Mark(index, self.text[start:end])

    def rows(self, start: int, stop: int | None = None) -> Marks:
        """Return the lines of some rows."""
        return Marks(self.table[start:stop], self.text)

    def compact(self) -> Marks:
        """Return the lines with a text of their own."""
        start, end = self.table[:, START], self.table[:, END] + 1
        runs = np.flatnonzero(start[1:] != end[:-1]) + 1  # where a line does not follow the last
        firsts, ends = start[np.append(0, runs)], end[np.append(runs - 1, len(end) - 1)]
        sizes = ends - firsts
        moved = np.repeat(firsts - (np.cumsum(sizes) - sizes), np.diff([0, *runs, len(end)]))
        pairs = zip(firsts.tolist(), ends.tolist(), strict=True)
        text = b"".join([self.text[first:end] for first, end in pairs])
        table = self.table.copy()
        table[:, START : END + 1] -= moved[:, None]
        return Marks(table, text)

    def count_before(self, index: int) -> int:
        """Return how many lines have a lower index."""
        return bisect_left(self.table[:, INDEX], index)  # searchsorted would copy the column

    def shifted(self, by: int) -> Marks:
        """Return the lines with their indices raised."""
        return self.moved_to(self.table[:, INDEX] + by) if by and len(self) else self

    def moved_to(self, at: Integers | int) -> Marks:
        """Return the lines with other indices, (k,) or one for all."""
        table = self.table.copy()
        table[:, INDEX] = at
        return Marks(table, self.text)


NO_MARKS = Marks(np.zeros((0, 4), np.int64), b"")
