"""Working ahead: the same items, the same exception, no thread left behind."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator

import pytest

from hframe_post.stream.prefetch import DEPTH, prefetch


@pytest.fixture(autouse=True)
def no_thread_is_left() -> Iterator[None]:
    before = set(threading.enumerate())
    yield
    assert set(threading.enumerate()) <= before


@pytest.mark.parametrize("n", [0, 1, DEPTH, 1000])
def test_items_come_in_order(n: int) -> None:
    assert list(prefetch(range(n))) == list(range(n))


def test_slow_consumer_gets_every_item() -> None:
    found = []
    for item in prefetch(range(6)):
        time.sleep(0.01)
        found.append(item)
    assert found == list(range(6))


def test_none_is_an_item_like_any_other() -> None:
    assert list(prefetch([None, 1, None])) == [None, 1, None]


def test_work_is_done_before_it_is_asked_for() -> None:
    made, enough = [], threading.Event()

    def source() -> Iterator[int]:
        for k in range(10):
            made.append(k)
            if k == DEPTH:
                enough.set()
            yield k

    items = prefetch(source())
    assert next(items) == 0
    assert enough.wait(5.0)
    assert len(made) <= DEPTH + 2
    assert list(items) == list(range(1, 10))


def test_nothing_is_done_before_the_first_item_is_asked_for() -> None:
    made = []

    def source() -> Iterator[int]:
        made.append(0)
        yield 0

    items = prefetch(source())
    assert made == []
    assert list(items) == made == [0]


class FaultError(Exception):
    pass


def failing(n: int) -> Iterator[int]:
    yield from range(n)
    raise FaultError("after the items")


@pytest.mark.parametrize("n", [0, 1, DEPTH, 7])
def test_exception_follows_the_items_before_it(n: int) -> None:
    found: list[int] = []
    with pytest.raises(FaultError, match="after the items"):
        found.extend(prefetch(failing(n)))
    assert found == list(range(n))


def test_exception_passes_through_several_stages() -> None:
    items = prefetch(k + 1 for k in prefetch(failing(5)))
    found: list[int] = []
    with pytest.raises(FaultError):
        found.extend(items)
    assert found == [1, 2, 3, 4, 5]


def endless() -> Iterator[int]:
    k = 0
    while True:
        yield k
        k += 1


def test_abandoned_stage_ends() -> None:
    items = prefetch(endless())
    assert next(items) == 0
    items.close()  # type: ignore[attr-defined]
    assert list(items) == []


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


def test_forgotten_stages_end() -> None:
    items = prefetch(-k for k in prefetch(endless()))
    assert [next(items) for _ in range(3)] == [0, -1, -2]
    del items
    deadline = time.monotonic() + 5.0
    while threading.active_count() > 1 and time.monotonic() < deadline:
        time.sleep(0.01)


def test_fault_of_the_consumer_ends_the_stage() -> None:
    def consume() -> None:
        for item in prefetch(endless()):
            if item == 3:
                raise FaultError

    with pytest.raises(FaultError):
        consume()
