"""Decimation: every sample within the tolerance of its chord, nothing forced left out."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hframe_post.arrays import Array, Flags
from hframe_post.firmware.decimate import LONGEST, breakpoints

TOLERANCE = 0.002


def wander(seed: int, n: int, power: float) -> tuple[Array, Flags]:
    """n + 1 points of a random motion, and some that must stay."""
    rng = np.random.default_rng(seed)
    velocity = rng.normal(0.0, 0.1, 4) + np.cumsum(rng.normal(0.0, 10.0**power, (n, 4)), axis=0)
    points = np.concatenate([np.zeros((1, 4)), np.cumsum(velocity, axis=0)])
    return points, rng.random(n + 1) < rng.choice([0.0, 0.05, 0.5])


def off_chord(points: Array, a: int, b: int) -> tuple[float, float, float]:
    """Greatest distance of the samples between from the chord: of x and y, of z, of e."""
    worst = [0.0, 0.0, 0.0]
    for k in range(a + 1, b):
        off = points[k] - points[a] - (points[b] - points[a]) * (k - a) / (b - a)
        for axis, distance in enumerate((np.hypot(off[0], off[1]), abs(off[2]), abs(off[3]))):
            worst[axis] = max(worst[axis], float(distance))
    return worst[0], worst[1], worst[2]


wanders = (st.integers(0, 2**32 - 1), st.integers(1, 100), st.floats(-6.0, -1.0))


@settings(max_examples=200, deadline=None)
@given(*wanders)
def test_every_sample_is_within_the_tolerance_of_its_chord(seed: int, n: int, power: float) -> None:
    points, forced = wander(seed, n, power)
    kept = [0, *breakpoints(points, forced, TOLERANCE).tolist()]
    for a, b in pairwise(kept):
        assert max(off_chord(points, a, b)) <= TOLERANCE * (1 + 1e-9)


@settings(max_examples=200, deadline=None)
@given(*wanders)
def test_forced_points_and_the_last_are_kept(seed: int, n: int, power: float) -> None:
    points, forced = wander(seed, n, power)
    kept = breakpoints(points, forced, TOLERANCE).tolist()
    assert kept == sorted(set(kept))
    assert kept[-1] == n
    assert kept[0] > 0
    assert set((np.flatnonzero(forced[1:]) + 1).tolist()) <= set(kept)


@settings(max_examples=200, deadline=None)
@given(*wanders)
def test_segments_are_the_longest_aligned_ones_that_fit(seed: int, n: int, power: float) -> None:
    points, forced = wander(seed, n, power)
    kept = [0, *breakpoints(points, forced, TOLERANCE).tolist()]
    for a, b in pairwise(kept):
        length = b - a
        assert length in (1, 2, 4, 8)
        assert a % length == 0
        start = a - a % (2 * length)
        stop = start + 2 * length
        if length < LONGEST and stop <= n:
            fits = max(off_chord(points, start, stop)) <= TOLERANCE * (1 - 1e-9)
            assert forced[start + 1 : stop].any() or not fits


@pytest.mark.parametrize("n", [1, 2, 3, 4, 5, 6, 7, 8, 9, 16, 17])
def test_straight_constant_motion_needs_a_point_in_eight(n: int) -> None:
    points = np.arange(n + 1)[:, None] * np.array([0.1, -0.2, 0.001, 0.004])
    kept = breakpoints(points, np.zeros(n + 1, dtype=bool), TOLERANCE).tolist()
    eighths = list(range(8, n + 1, 8))
    rest, at = [], n - n % 8
    for length in (4, 2, 1):
        if n - at >= length:
            at += length
            rest.append(at)
    assert kept == eighths + rest


def test_standstill_needs_a_point_in_eight() -> None:
    kept = breakpoints(np.ones((33, 4)), np.zeros(33, dtype=bool), TOLERANCE)
    assert kept.tolist() == [8, 16, 24, 32]


@pytest.mark.parametrize("n", [1, 5, 8, 9, 40])
def test_without_tolerance_a_curve_keeps_every_point(n: int) -> None:
    angle = 0.1 * np.arange(n + 1)
    points = np.stack([np.cos(angle), np.sin(angle), 0 * angle, 0 * angle], axis=1)
    kept = breakpoints(points, np.zeros(n + 1, dtype=bool), 1e-9)
    assert kept.tolist() == list(range(1, n + 1))


@pytest.mark.parametrize(("axes", "fits"), [((0,), False), ((0, 1), False), ((2,), False),
                                            ((3,), False), ((), True)])  # fmt: skip
def test_each_kind_of_axis_has_the_tolerance_to_itself(axes: tuple[int, ...], fits: bool) -> None:
    """x and y share one; z and e have their own."""
    points = np.zeros((9, 4))
    points[4, list(axes)] = 1.01 * TOLERANCE / np.sqrt(len(axes) or 1)
    kept = breakpoints(points, np.zeros(9, dtype=bool), TOLERANCE)
    assert (kept.tolist() == [8]) == fits


def test_x_z_and_e_do_not_add_up() -> None:
    points = np.zeros((9, 4))
    points[4, [0, 2, 3]] = 0.99 * TOLERANCE
    assert breakpoints(points, np.zeros(9, dtype=bool), TOLERANCE).tolist() == [8]


def test_uneven_motion_along_a_line_is_not_smoothed_away() -> None:
    """A chord is driven at one speed: place in time counts, not the line alone."""
    points = np.zeros((9, 4))
    points[5:, 0] = 1.0
    kept = breakpoints(points, np.zeros(9, dtype=bool), TOLERANCE).tolist()
    assert {4, 5} <= set(kept)


def test_arguments_stay_as_they_are() -> None:
    points, forced = wander(1, 21, -2.0)
    before = points.copy(), forced.copy()
    breakpoints(points, forced, TOLERANCE)
    np.testing.assert_array_equal(points, before[0])
    np.testing.assert_array_equal(forced, before[1])


def test_nothing_to_keep_of_a_single_point() -> None:
    assert breakpoints(np.zeros((1, 4)), np.zeros(1, dtype=bool), TOLERANCE).tolist() == []
