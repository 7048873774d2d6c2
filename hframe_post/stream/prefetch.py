"""A stage that works ahead in a thread of its own: numpy leaves the interpreter free."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from queue import Full, Queue
from threading import Event, Thread
from typing import TypeVar

T = TypeVar("T")

DEPTH = 2  # items that may wait
POLL = 0.1  # s between looks at whether anyone still wants them


def ahead(items: Iterable[T]) -> Iterator[T]:
    """The same items in the same order; up to DEPTH are made before they are asked for.

    An exception of the source is raised here, after the items before it.
    """
    queue: Queue[T | _End] = Queue(DEPTH)
    unwanted = Event()

    def put(item: T | _End) -> None:
        while not unwanted.is_set():
            try:
                return queue.put(item, timeout=POLL)
            except Full:
                continue

    def work() -> None:
        try:
            for item in items:
                put(item)
                if unwanted.is_set():
                    return
            put(_End(None))
        except BaseException as error:
            put(_End(error))

    worker = Thread(target=work, daemon=True)
    worker.start()
    try:
        while not isinstance(item := queue.get(), _End):
            yield item
        if item.error is not None:
            raise item.error
    finally:
        unwanted.set()
        worker.join()


class _End:
    """No more items, and why."""

    def __init__(self, error: BaseException | None) -> None:
        self.error = error
