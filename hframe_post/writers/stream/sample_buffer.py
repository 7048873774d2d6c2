"""Samples on their way to the text: held until there are enough to be written together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hframe_post.arrays import Array, Flags, Integers
from hframe_post.stream.types import Mark

SAMPLES_AT_ONCE = 1 << 14


@dataclass(frozen=True, slots=True)
class Batch:
    """n samples that are written together.

    first: index of the first; points (n + 1, 4): x, y, z, e in mm, beginning where the machine
    stands before them; marks: the lines that pass before one of them; last: motion ends here.
    """

    first: int
    points: Array
    marks: tuple[Mark, ...]
    last: bool

    def __len__(self) -> int:
        return len(self.points) - 1

    @property
    def marked(self) -> Integers:
        """The points (len(marks),) of the marks."""
        return np.array([mark.index - self.first + 1 for mark in self.marks], dtype=np.int64)

    @property
    def forced(self) -> Flags:
        """Points (n + 1,) at which a line of the file is to pass."""
        forced = np.zeros(len(self.points), dtype=bool)
        forced[self.marked] = True
        return forced


class Held:
    """Contiguous samples and the lines between them, taken in order, given in batches."""

    def __init__(self) -> None:
        self._points: list[Array] = []
        self._count = 0
        self._start = np.zeros(4)  # the point before the first
        self._index = 0  # of the first
        self._marks: list[Mark] = []

    def __len__(self) -> int:
        return self._count

    def take(self, points: Array, index: int, stand: Array) -> None:
        """Samples (n, 4) from ``index`` on; stand (4,): where the machine is before the first."""
        if not self._count:
            self._index, self._start = index, stand
        self._points.append(points)
        self._count += len(points)

    def mark(self, mark: Mark) -> None:
        """A line that passes before its sample, which is not written before it is known."""
        self._marks.append(mark)

    def batch(self, last: bool) -> Batch | None:
        """The next SAMPLES_AT_ONCE, or all of them where motion ends; None: there are none."""
        if not self._count:
            return None
        held = np.concatenate([self._start[None], *self._points])
        n = self._count if last else SAMPLES_AT_ONCE
        points = held[: n + 1]
        marks = tuple(mark for mark in self._marks if mark.index - self._index < n)
        batch = Batch(self._index, points, marks, last)
        self._marks = self._marks[len(marks) :]
        self._count -= n
        self._points = [held[n + 1 :]] if self._count else []
        self._start, self._index = points[-1], self._index + n
        return batch

    def passing(self, index: int | None = None) -> list[Mark]:
        """Lines that pass at standstill: up to a sample, or up to the next that is taken."""
        index = self._index if index is None else index
        count = sum(mark.index <= index for mark in self._marks)
        now, self._marks = self._marks[:count], self._marks[count:]
        return now
