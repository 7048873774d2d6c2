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
        self._pieces: list[tuple[Array, Integers]] = []
        self._first = 0

    @property
    def count(self) -> int:
        return self.index - self._first

    def add(self, xyze: Array, line: Integers) -> None:
        if len(xyze):
            self._pieces.append((xyze, line))
            self.index += len(xyze)
            self.last = xyze[-1]

    def mark(self, lines: Marks) -> None:
        """Add lines that pass before the next sample."""
        self.events.append(lines.moved_to(self.index))

    def rest(self, where: Array, samples: int) -> Iterator[Samples]:
        """Add samples at rest; yield the chunks that are full."""
        for first in range(0, samples, self.size):
            n = min(samples - first, self.size)
            xyze = np.empty((n, 4))
            xyze[:] = where
            self.add(xyze, np.full(n, self.line))
            if first + n < samples:
                yield from self.flush()

    def skip(self, where: Array, samples: int) -> Iterator[Samples]:
        """End the stretch; leave out all of these samples but the last, which is ``where``."""
        yield from self.flush(ends_stretch=True)
        self.index += samples - 1
        self._first = self.index
        self.add(np.array([where]), np.array([self.line]))

    def flush(self, ends_stretch: bool = False) -> Iterator[Samples]:
        if not self._pieces and not self.events:
            return
        nothing = np.zeros((0, 4)), np.zeros(0, dtype=np.int64)
        xyze, line = (np.concatenate(each) for each in zip(*self._pieces or [nothing], strict=True))
        first, events = self._first, tuple(self.events)
        self._pieces, self.events, self._first = [], [], self.index
        yield Samples(first, frozen(xyze), line, events, ends_stretch=ends_stretch)
