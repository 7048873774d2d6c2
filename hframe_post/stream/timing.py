"""Which stage takes how much of the processor.

A stage's own time is what passes in its thread while it is asked for an item, without what the
stages before it take meanwhile. Time in which it only waits does not count.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Iterable, Iterator
from typing import TypeVar

T = TypeVar("T")


class StageTimes:
    """``seconds``: of each stage, in the order in which they were first asked."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._asked = threading.local()  # in each thread: seconds of the stages before, nested

    def timed(self, stage: str, items: Iterable[T]) -> Iterator[T]:
        """The same items; how long they take is noted. Several streams may be of one stage."""
        source, end = iter(items), object()
        while (item := self._next(stage, source, end)) is not end:
            yield item  # type: ignore[misc]  # the end is the only one that is no T

    def _next(self, stage: str, source: Iterator[T], end: object) -> T | object:
        stack: list[float] = self._asked.__dict__.setdefault("stack", [])
        stack.append(0.0)
        begun = time.thread_time()
        try:
            return next(source, end)
        finally:
            spent = time.thread_time() - begun
            before = stack.pop()
            self.seconds[stage] = self.seconds.get(stage, 0.0) + spent - before
            if stack:
                stack[-1] += spent


def joined(one: dict[str, float], other: dict[str, float]) -> dict[str, float]:
    """The seconds of both."""
    stages = {**one, **other}
    return {stage: one.get(stage, 0.0) + other.get(stage, 0.0) for stage in stages}
