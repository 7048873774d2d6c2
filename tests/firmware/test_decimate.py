"""Decimation: every sample within the tolerance of its chord, nothing forced left out."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hframe_post.arrays import TS, Array, Flags, Integers
from hframe_post.firmware.klipper.klipper_stream import PIECE_SAMPLES, sparser
from hframe_post.native.decimate import breakpoints, fitted
from tests.paths import wander

MM = 0.002  # tolerance of most tests
SHORT, E_WEIGHT = 8, 4.0  # samples up to which it counts in full; mm of path a mm of filament


def none(n: int) -> Flags:
    return np.zeros(n + 1, dtype=bool)


def off_chord(points: Array, a: int, b: int) -> float:
    """Greatest distance of the samples between from the chord: of x and y, of z, of e."""
    share = np.arange(b - a + 1)[:, None] / (b - a)
    off = points[a : b + 1] - (points[a] + share * (points[b] - points[a]))
    z_e = np.abs(off[:, 2:] * (1.0, E_WEIGHT)).max()
    return float(max(np.hypot(off[:, 0], off[:, 1]).max(), z_e))


wanders = (st.integers(0, 2**32 - 1), st.integers(1, 100), st.floats(-6.0, -1.0))


@settings(max_examples=80, deadline=None)
@given(*wanders)
def test_samples_are_within_the_tolerance(seed: int, n: int, power: float) -> None:
    points, forced = wander(seed, n, power)
    kept = [0, *breakpoints(points, forced, MM).tolist()]
    for a, b in pairwise(kept):
        allowed = MM * min(1.0, np.sqrt(SHORT / (b - a)))
        assert off_chord(points, a, b) <= allowed * (1 + 1e-9)


@settings(max_examples=80, deadline=None)
@given(*wanders)
def test_forced_points_and_the_last_are_kept(seed: int, n: int, power: float) -> None:
    points, forced = wander(seed, n, power)
    kept = breakpoints(points, forced, MM).tolist()
    assert kept == sorted(set(kept))
    assert kept[-1] == n
    assert kept[0] > 0
    assert set((np.flatnonzero(forced[1:]) + 1).tolist()) <= set(kept)


@pytest.mark.parametrize("n", [1, 2, 3, 8, 9, 17, 1000, 16_384])
def test_a_straight_at_constant_speed_is_one_segment(n: int) -> None:
    points = np.arange(n + 1)[:, None] * np.array([0.1, -0.2, 0.001, 0.004])
    assert breakpoints(points, none(n), MM).tolist() == [n]
    assert breakpoints(np.ones((n + 1, 4)), none(n), MM).tolist() == [n]


@pytest.mark.parametrize("n", [1, 5, 8, 9, 40])
def test_without_tolerance_a_curve_keeps_every_point(n: int) -> None:
    angle = 0.1 * np.arange(n + 1)
    points = np.stack([np.cos(angle), np.sin(angle), 0 * angle, 0 * angle], axis=1)
    assert breakpoints(points, none(n), 1e-9).tolist() == list(range(1, n + 1))


@pytest.mark.parametrize(("axes", "fits"), [((0,), False), ((0, 1), False), ((2,), False),
                                            ((3,), False), ((), True)])  # fmt: skip
def test_each_kind_of_axis_has_the_tolerance_to_itself(axes: tuple[int, ...], fits: bool) -> None:
    """x and y share one; z and e have their own."""
    points = np.zeros((9, 4))
    off = 1.01 * MM / np.sqrt(len(axes) or 1)
    points[4, list(axes)] = off / E_WEIGHT if axes == (3,) else off
    assert (breakpoints(points, none(8), MM).tolist() == [8]) == fits


def test_uneven_motion_along_a_line_is_not_smoothed_away() -> None:
    """A chord is driven at one speed: place in time counts, not the line alone."""
    points = np.zeros((9, 4))
    points[5:, 0] = 1.0
    assert {4, 5} <= set(breakpoints(points, none(8), MM).tolist())


def hats(n: int, ends: Integers) -> Array:
    """The polyline's value at samples 1 … n by that at its vertices, (n, k + 1)."""
    at, vertices = np.arange(1, n + 1), np.append(0, ends)
    return np.column_stack([np.interp(at, vertices, row) for row in np.eye(len(vertices))])


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(4, 300), st.floats(-6.0, -2.0))
def test_vertices_are_those_of_least_squares(seed: int, n: int, power: float) -> None:
    points, forced = wander(seed, n, power)
    points[:, :2] *= 1e-3  # so that nothing is cut off at the edge
    ends = breakpoints(points, forced, MM)
    H, xy = hats(n, ends), points[:, :2]
    fixed = np.outer(H[:, 0], xy[0]) + np.outer(H[:, -1], xy[-1])
    free = np.linalg.lstsq(H[:, 1:-1], xy[1:] - fixed, rcond=None)[0]
    low, high = xy.min(axis=0), xy.max(axis=0)
    found = fitted(points, ends)
    scale = np.abs(free - xy[ends[:-1]]).max(initial=0.0)
    np.testing.assert_allclose(found[:-1, :2], np.clip(free, low, high), atol=1e-3 * scale + 1e-12)
    np.testing.assert_array_equal(found[-1], points[-1])
    np.testing.assert_array_equal(found[:, 2:], points[ends, 2:])


def test_no_vertex_leaves_the_bed_where_no_sample_does() -> None:
    t = np.linspace(-1.0, 1.0, 401)
    points = np.column_stack([100.0 * t, 5.0 * t * t, 0 * t, 0 * t])
    vertices = fitted(points, breakpoints(points, none(400), 0.01))
    assert vertices[:, 1].min() >= 0.0


@pytest.mark.parametrize("rate", [20.0, 60.0, 200.0])
def test_a_bound_on_lines_is_kept_where_forced_points_allow(rate: float) -> None:
    points, forced = wander(5, 4000, -2.0)
    forced = np.zeros_like(forced)
    forced[[100, 700, 701, 702]] = True
    ends = breakpoints(points, forced, MM)
    fewer = sparser(points, forced, MM, ends, rate)
    n = len(points) - 1
    assert fewer[-1] == n
    assert set(np.flatnonzero(forced).tolist()) <= set(fewer.tolist())
    assert (np.diff(fewer) > 0).all()
    pieces = range(0, n + 1, PIECE_SAMPLES)
    counts, before = (np.histogram(e, [*pieces, n + 1])[0] for e in (fewer, ends))
    assert before.max() > 60.0 * PIECE_SAMPLES * TS  # the bound asks for something
    assert (counts <= np.maximum(rate * PIECE_SAMPLES * TS, 4) + 2).all()  # ends of pieces stay
    points[: PIECE_SAMPLES + 40] = points[PIECE_SAMPLES + 40]  # one segment, into the second piece
    calm = sparser(points, forced, MM, breakpoints(points, forced, MM), rate)
    assert PIECE_SAMPLES in calm, "where a coarser piece begins"
