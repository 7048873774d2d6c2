"""Re-cutting loses no sample and no event, wherever it cuts."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from hframe_post.stream.chunks import join, part, with_neighbours
from hframe_post.stream.marks import Mark, Marks
from hframe_post.stream.types import Samples, frozen
from tests.mark_tools import mark

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
