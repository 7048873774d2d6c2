"""A stage is charged for its own work: not for waiting, nor for the stages before it."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator

import pytest

from hframe_post.stream.prefetch import prefetch
from hframe_post.stream.timing import StageTimes, joined

WORK = 0.02  # s of the processor for an item


def working(items: Iterable[int], seconds: float) -> Iterator[int]:
    for item in items:
        until = time.thread_time() + seconds
        while time.thread_time() < until:
            pass
        yield item


@pytest.mark.parametrize("threads", [False, True])
def test_own_time_in_one_thread_and_in_several(threads: bool) -> None:
    times = StageTimes()
    first: Iterable[int] = times.timed("first", working(range(4), WORK))
    first = prefetch(first) if threads else first
    second = times.timed("second", working(first, 3 * WORK))
    assert list(times.timed("third", (item for item in second))) == [0, 1, 2, 3]
    assert times.seconds["first"] == pytest.approx(4 * WORK, rel=0.2)
    assert times.seconds["second"] == pytest.approx(12 * WORK, rel=0.2)
    assert times.seconds["third"] < WORK


def test_an_error_passes_and_waiting_is_free() -> None:
    def failing() -> Iterator[int]:
        time.sleep(5 * WORK)
        yield 1
        raise ValueError("lost")

    times = StageTimes()
    stream = times.timed("stage", failing())
    assert next(stream) == 1
    with pytest.raises(ValueError, match="lost"):
        next(stream)
    assert times.seconds["stage"] < WORK
    assert joined({"a": 1.0}, {"b": 2.0, "a": 3.0}) == {"a": 4.0, "b": 2.0}
