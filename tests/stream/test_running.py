"""Prefetching leaves items, errors and threads in order; each stage is charged its own time."""

import threading
from collections.abc import Iterator

import pytest

from hframe_post.stream.running import PREFETCHED_ITEMS, prefetch


@pytest.fixture(autouse=True)
def no_thread_is_left() -> Iterator[None]:
    before = set(threading.enumerate())
    yield
    assert set(threading.enumerate()) <= before


@pytest.mark.parametrize("n", [0, 1, PREFETCHED_ITEMS, 1000])
def test_items_come_in_order(n: int) -> None:
    assert list(prefetch(range(n))) == list(range(n))


def test_work_is_done_before_it_is_asked_for() -> None:
    made, enough = [], threading.Event()

    def source() -> Iterator[int]:
        for k in range(10):
            made.append(k)
            if k == PREFETCHED_ITEMS:
                enough.set()
            yield k

    items = prefetch(source())
    assert next(items) == 0
    assert enough.wait(5.0)
    assert len(made) <= PREFETCHED_ITEMS + 2
    assert list(items) == list(range(1, 10))


class FaultError(Exception):
    pass


def failing(n: int) -> Iterator[int]:
    yield from range(n)
    raise FaultError("after the items")


@pytest.mark.parametrize("n", [0, 1, PREFETCHED_ITEMS, 7])
def test_exception_follows_the_items_before_it(n: int) -> None:
    found: list[int] = []
    with pytest.raises(FaultError, match="after the items"):
        found.extend(prefetch(failing(n)))
    assert found == list(range(n))


def endless() -> Iterator[int]:
    k = 0
    while True:
        yield k
        k += 1


def test_abandoned_stage_closes_its_source() -> None:
    closed = threading.Event()

    def source() -> Iterator[int]:
        try:
            yield from endless()
        finally:
            closed.set()

    items = prefetch(source())
    next(items)
    items.close()  # type: ignore[attr-defined]
    del items
    assert closed.wait(5.0)


def test_fault_of_the_consumer_ends_the_stage() -> None:
    def consume() -> None:
        for item in prefetch(endless()):
            if item == 3:
                raise FaultError

    with pytest.raises(FaultError):
        consume()
