"""A stage that runs in a thread of its own: numpy leaves the interpreter free."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

T = TypeVar("T")

DEPTH = 2  # items that are made, or in the making, before they are asked for


def prefetch(items: Iterable[T]) -> Iterator[T]:
    """The same items in the same order; up to DEPTH are made before they are asked for.

    An exception of the source is raised here, after the items before it. Once nobody asks any
    more, no further item is begun.
    """
    source, end = iter(items), object()
    worker = ThreadPoolExecutor(1, "prefetch")
    try:
        waiting = deque(worker.submit(next, source, end) for _ in range(DEPTH))
        while (item := waiting.popleft().result()) is not end:
            waiting.append(worker.submit(next, source, end))
            yield item  # type: ignore[misc]  # the end is the only one that is no T
    finally:
        worker.shutdown(cancel_futures=True)
