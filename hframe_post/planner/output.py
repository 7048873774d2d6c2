"""Samples and events on their way out of the planner."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from hframe_post.arrays import Array, Integers
from hframe_post.stream.marks import Marks
from hframe_post.stream.types import Event, Samples, frozen


class Output:
    """Samples and events that are not yielded yet. size: samples that make a chunk."""

    def __init__(self, size: int) -> None:
        self.size = size
        self.index = 0  # of the next sample
        self.line = 0  # source line of samples at rest
        self.last: Array | None = None  # x, y, z, e at the last sample; None if unknown
        self.events: list[Event] = []
        # of one chunk after the other, with room for what comes when one is almost full
        self._first = 0
        self._xyze, self._line = np.empty((2 * size, 4)), np.empty(2 * size, np.int64)

    @property
    def count(self) -> int:
        return self.index - self._first

    def room(self, samples: int) -> tuple[Array, Integers]:
        """Add samples; return their places and lines, to be filled in."""
        rows = slice(self.count, self.count + samples)
        if rows.stop > len(self._line):  # many rests in a small chunk
            more = max(len(self._line), samples)
            self._xyze = np.pad(self._xyze, ((0, more), (0, 0)))
            self._line = np.pad(self._line, (0, more))
        self.index += samples
        xyze, line = self._xyze[rows], self._line[rows]
        if samples:
            self.last = xyze[-1]
        return xyze, line

    def mark(self, lines: Marks) -> None:
        """Add lines that pass before the next sample."""
        self.events.append(lines.moved_to(self.index))

    def rest(self, where: Array, samples: int) -> None:
        """Add samples at rest."""
        xyze, line = self.room(samples)
        xyze[:], line[:] = where, self.line

    def skip(self, where: Array, samples: int) -> Iterator[Samples]:
        """End the stretch; leave out all of these samples but the last, which is ``where``."""
        yield from self.flush(ends_stretch=True)
        self.index += samples - 1
        self._first = self.index
        self.rest(where, 1)

    def flush(self, ends_stretch: bool = False) -> Iterator[Samples]:
        if not self.count and not self.events:
            return
        first, n, events = self._first, self.count, tuple(self.events)
        xyze, line = frozen(self._xyze[:n].copy()), self._line[:n].copy()
        self.events, self._first = [], self.index
        if n:
            self.last = xyze[-1]  # the buffer is written over
        yield Samples(first, xyze, line, events, ends_stretch=ends_stretch)
