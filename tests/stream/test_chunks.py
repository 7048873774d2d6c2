"""Re-cutting loses no sample and no event, wherever it cuts."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hframe_post.stream.chunks import join, part, stretches, with_neighbours
from hframe_post.stream.marks import Mark, Marks
from hframe_post.stream.types import (
    Dwell,
    Event,
    Handling,
    ModalState,
    Passthrough,
    Samples,
    frozen,
)
from tests.mark_tools import mark
from tests.paths import smaller

STATE = ModalState(True, True, 0.0, 60.0, (0.0, 0.0, 0.0))
SIZES = st.lists(st.integers(0, 9), min_size=1, max_size=12)


def stream(sizes: list[int], first: int = 5) -> list[Samples]:
    """Blocks whose every sample tells its index, with two marks at every other index."""
    blocks = []
    for n in sizes:
        index = np.arange(first, first + n)
        events = tuple(mark(int(k), b"%d %d" % (k, m)) for k in index[::2] for m in range(2))
        events += (mark(first + n, b"end"),)
        xyze = frozen(np.repeat(index[:, None], 4, axis=1).astype(float))
        commands = {"racking": frozen(xyze[:, :2] + 0.5), "none": xyze[:, :2]}
        blocks.append(Samples(first, xyze, 10 * index, events, commands))
        first += n
    return blocks


def assert_same(one: Samples, other: Samples) -> None:
    assert one.first == other.first
    np.testing.assert_array_equal(one.xyze, other.xyze)
    np.testing.assert_array_equal(one.line, other.line)
    assert one.events == other.events
    assert one.commands.keys() == other.commands.keys()
    for name, command in one.commands.items():
        np.testing.assert_array_equal(command, other.commands[name])


@given(SIZES)
def test_join_keeps_samples_events_and_commands_in_order(sizes: list[int]) -> None:
    blocks = stream(sizes)
    joined = join(blocks)
    assert (joined.first, len(joined)) == (5, sum(sizes))
    np.testing.assert_array_equal(joined.xyze[:, 0], np.arange(5, 5 + sum(sizes)))
    np.testing.assert_array_equal(joined.line, 10 * np.arange(5, 5 + sum(sizes)))
    np.testing.assert_array_equal(joined.commands["racking"], joined.xyze[:, :2] + 0.5)
    assert joined.events == tuple(e for b in blocks for e in b.events)
    assert not joined.xyze.flags.writeable


def test_a_part_between_two_lines_has_neither() -> None:
    lines = Marks.from_lines([Mark(7, b";first"), Mark(12, b";last")])
    whole = replace(stream([10])[0], events=(lines,))
    assert part(whole, 3, 6).events == ()
    assert part(whole, 2, 3).events == (lines.rows(0, 1),)


@given(st.integers(1, 30), st.lists(st.integers(1, 29), unique=True))
def test_parts_join_to_the_whole(n: int, cuts: list[int]) -> None:
    (whole,) = stream([n])
    edges = [0, *sorted(c for c in cuts if c < n), n]
    parts = [part(whole, a, b) for a, b in pairwise(edges)]
    assert_same(join(parts), whole)
    for piece in parts:
        assert all(piece.first <= e.index <= piece.end for e in piece.events)


@given(SIZES, st.integers(1, 9))
def test_smaller_chunks_are_the_same_stream(sizes: list[int], n: int) -> None:
    blocks = stream(sizes)
    done = list(smaller(blocks, n))
    assert max(map(len, done)) <= n
    assert_same(join(done), join(blocks))


@given(SIZES, st.integers(0, 20), st.integers(0, 20))
def test_neighbours_are_those_of_the_whole(sizes: list[int], before: int, after: int) -> None:
    blocks = stream(sizes)
    total, seen, every = sum(sizes), [], [e for b in blocks for e in b.events]
    for block, wide, where in with_neighbours(blocks, before, after):
        seen.append(block)
        start, stop = block.first - 5, block.end - 5
        low, high = max(start - before, 0), min(stop + after, total)
        assert wide.first == 5 + low
        np.testing.assert_array_equal(wide.xyze[:, 0], np.arange(5 + low, 5 + high))
        np.testing.assert_array_equal(wide.commands["none"], wide.xyze[:, :2])
        assert (where.start, where.stop) == (start - low, stop - low)
        np.testing.assert_array_equal(wide.xyze[where], block.xyze)
        inside = [e for e in wide.events if wide.first < e.index < wide.end]
        assert inside == [e for e in every if wide.first < e.index < wide.end]
        assert set(block.events) <= set(wide.events)
    assert [id(b) for b in seen] == [id(b) for b in blocks]


@pytest.mark.parametrize(("after", "read"), [(0, 1), (1, 2), (5, 2), (6, 3)])
def test_neighbours_are_given_as_soon_as_they_are_known(after: int, read: int) -> None:
    taken = []

    def source() -> object:
        for block in stream([5, 5, 5, 5]):
            taken.append(block)
            yield block

    wide = with_neighbours(source(), 0, after)  # type: ignore[arg-type]
    next(wide)
    assert len(taken) == read


def yielding(block: Samples, handling: Handling = Handling.RELEASE) -> Samples:
    action = Passthrough(1, b"G28", handling, STATE)
    events: tuple[Event, ...] = (*block.events, Dwell(block.end, 0, action))
    return replace(block, events=events, ends_stretch=handling is Handling.RELEASE)


@given(st.lists(st.booleans(), max_size=12))
def test_stretches_end_where_the_machine_is_yielded(yields: list[bool]) -> None:
    blocks = [
        yielding(block) if flag else block
        for block, flag in zip(stream([3] * len(yields)), yields, strict=True)
    ]
    found = [list(stretch) for stretch in stretches(blocks)]
    assert [id(b) for stretch in found for b in stretch] == [id(b) for b in blocks]
    for stretch in found:
        assert not any(block.ends_stretch for block in stretch[:-1])
    for stretch in found[:-1]:
        assert stretch[-1].ends_stretch
    assert len(found) == sum(yields) + (len(yields) > 0 and not yields[-1])
