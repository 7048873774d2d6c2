"""The compiled loops of the writer give the same bits as numpy."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from hframe_post.arrays import Array
from hframe_post.firmware.klipper import ramps, segments
from hframe_post.firmware.marlin.block_times import Timer, block_times
from hframe_post.firmware.marlin.blocks import BlockLimits, Blocks, blocks_between
from hframe_post.firmware.marlin.planner import SteppedPlanner, make_planner
from hframe_post.firmware.marlin.segments import segment_ends
from hframe_post.model.kinematics import Kinematics
from hframe_post.printer.settings import Printer
from hframe_post.writers.stream import digits
from hframe_post.writers.stream.segments import Units, _moving
from tests.native.comparing import in_numpy, same, seeds, thorough
from tests.random_paths import wander


@thorough
@given(seeds, st.integers(1, 400), st.floats(-6.0, -1.0), st.booleans(), st.floats(1e-3, 0.1))
def test_decimation(
    compiled: None, seed: int, n: int, power: float, coarse: bool, tolerance: float
) -> None:
    """Rounded points have many chords with equal errors."""
    points, forced = wander(seed, n, power)
    points = points.round(3) if coarse else points
    ends = segments.breakpoints(points, forced, tolerance)
    same(ends, segments._breakpoints(points, forced, tolerance))
    same(segments.fitted(points, ends), segments._fitted(points, ends))


@thorough
@given(seeds, st.integers(1, 60), st.sampled_from([0.0, 0.3, 1.0]))
def test_segments_that_are_too_thick(compiled: None, seed: int, k: int, lays: float) -> None:
    """Some segments extrude ten times as much as the others, and some stand still."""
    rng = np.random.default_rng(seed)
    ends = np.cumsum(rng.integers(1, 40, k))
    steps = rng.uniform(0.0, 0.1, (int(ends[-1]) + 1, 4)) * (1.0, 1.0, 0.0, 0.04)
    steps[:, 3] *= np.where(rng.random(len(steps)) < 0.1, 10.0, 1.0) * (rng.random() < lays)
    steps[:, :3] *= rng.random((len(steps), 1)) < rng.choice([0.1, 1.0])
    points = np.cumsum(steps, axis=0)
    which, most = segments.too_thick(points, ends)
    plain, most_plain = in_numpy(segments.too_thick, points, ends)
    same(which, plain)
    assert most == most_plain


@thorough
@given(seeds, st.integers(1, 300), st.floats(-4.0, 1.0), st.booleans())
def test_ramps(
    compiled: None, paper: Printer, seed: int, k: int, power: float, lifts: bool
) -> None:
    """Some segments are straight on or straight back, and some are too short for their time."""
    rng = np.random.default_rng(seed)
    limits = ramps.StreamLimits.from_limits(paper.limits, paper.motors, paper.kinematics)
    moves = rng.normal(0.0, 10.0**power, (k, 4)).round(3) * (1.0, 1.0, lifts, 0.04)
    moves[rng.random(k) < 0.2] = moves[0] * rng.choice([1.0, -1.0])
    moves[:, 0] = np.where(moves[:, 0] == 0.0, 0.001, moves[:, 0])
    at = np.cumsum(np.vstack([np.zeros(4), moves]), axis=0)
    T: Array = 1e-3 * np.ceil(rng.uniform(0.0, 200.0, k))
    v: Array = rng.uniform(0.1, 700.0, k)
    rest = rng.random(k + 1) < rng.choice([0.0, 0.1])
    before = float(rng.choice([0.0, 60.0]))
    asked = at, T, rest, before, np.inf, limits, 600.0
    for found, plain in zip(ramps.feeds(*asked), in_numpy(ramps.feeds, *asked), strict=True):
        same(found, plain)
    same(ramps.durations(at, v, *asked[2:-1]), in_numpy(ramps.durations, at, v, *asked[2:-1]))


def stepped(build: str, timer: Timer) -> SteppedPlanner:
    """Return the planner of a generation with S-curves, with classic jerk, or without both."""
    generation, *options = build.split()
    planner = make_planner(generation, timer, "jerk" in options, "curved" in options)
    assert isinstance(planner, SteppedPlanner)
    return planner


@thorough
@given(
    seeds, st.integers(1, 40), st.sampled_from(["2.0", "2.1", "2.1 curved", "2.1-dev"]),
    st.booleans(), st.sampled_from([0.0, 4e4]),
)  # fmt: skip
def test_block_times(
    compiled: None, seed: int, k: int, build: str, extra_tick: bool, smoothing_hz: float
) -> None:
    """Some blocks are too short for their ramps, and some begin or end at their own rate."""
    rng = np.random.default_rng(seed)
    timer = Timer(float(rng.choice([2e6, 1e15])), extra_tick, smoothing_hz)
    n = np.ceil(10.0 ** rng.uniform(0.0, 2.5, k))
    rate = np.ceil(10.0 ** rng.uniform(1.0, 4.5, k))
    begin, end = rate * np.minimum(rng.uniform(0.0, 1.5, (2, k)), 1.0)
    blocks = Blocks(n, n * 0.0025, 10.0 ** rng.uniform(4.0, 7.0, k))
    arguments = blocks, begin, rate, end, stepped(build, timer).stepper
    same(block_times(*arguments), in_numpy(block_times, *arguments))


@settings(thorough, max_examples=25)
@given(
    seeds, st.integers(1, 300),
    st.sampled_from(["2.0", "2.1", "2.1 curved", "2.1 jerk", "2.1-dev"]),
    st.booleans(), st.sampled_from([0.0, 4e4]),
)  # fmt: skip
def test_feed_rates(
    compiled: None, seed: int, k: int, build: str, extra_tick: bool, smoothing_hz: float
) -> None:
    """Some blocks are too short for their time, and some turn back."""
    rng = np.random.default_rng(seed)
    planner = stepped(build, Timer(2e6, extra_tick, smoothing_hz))
    n = np.ceil(10.0 ** rng.uniform(0.0, 2.0, k))
    d, T = n * rng.uniform(0.0025, 0.0125, k), 1e-3 * np.ceil(10.0 ** rng.uniform(0.0, 2.0, k))
    corners = np.where(rng.random(k + 1) < 0.2, rng.uniform(0.0, 50.0, k + 1), np.inf)
    blocks = Blocks(n, d, 10.0 ** rng.uniform(4.0, 7.0, k), corners)
    before, v = float(rng.choice([0.0, 60.0])), np.ceil(60.0 * d / T) / 60.0
    for function, numbers in (
        (planner.possible_times, T), (planner.feed_rates, T), (planner.durations, v),
    ):  # fmt: skip
        same(function(blocks, numbers, before), in_numpy(function, blocks, numbers, before))


@thorough
@given(
    seeds,
    st.integers(1, 40),
    st.sampled_from([0.3, np.inf]),
    st.sampled_from(["corexy", "cartesian"]),
)
def test_blocks(compiled: None, seed: int, k: int, deviation: float, kinematics: str) -> None:
    """Some blocks stand in x and y, some in all, and some turn straight back."""
    rng = np.random.default_rng(seed)
    moves = rng.normal(0.0, 1.0, (k, 4)) * (rng.random((k, 4)) < rng.choice([0.5, 0.9]))
    moves[rng.random(k) < 0.2] = moves[0] * rng.choice([1.0, -1.0])
    at = np.cumsum(np.vstack([np.zeros(4), moves]), axis=0)
    limits = BlockLimits(0.0125, 0.0025, 0.0024, 3e4, 100.0, 6e3, 5e3, deviation)
    arguments = at, float(rng.choice([30.0, np.inf])), limits, Kinematics(kinematics)
    for one, other in zip(
        blocks_between(*arguments), in_numpy(blocks_between, *arguments), strict=True
    ):
        same(np.asarray(one), np.asarray(other))


@thorough
@given(seeds, st.integers(1, 600), st.integers(0, 8), st.integers(1, 6), st.booleans())
def test_segments_on_whole_steps(
    compiled: None, seed: int, n: int, least: int, apart: int, last: bool
) -> None:
    """Motors chatter about their places, turn a few steps apart, and stand."""
    rng = np.random.default_rng(seed)
    speed = rng.uniform(0.0, 4.0) * np.sin(np.arange(n)[:, None] * rng.uniform(0.0, 0.3, 2))
    steps = np.rint(speed + rng.normal(0.0, rng.choice([0.1, 0.6]), (n, 2))).astype(np.int64)
    first, many = rng.integers(0, n, 4), rng.integers(0, 60, 4)
    for start, count in zip(first.tolist(), many.tolist(), strict=True):
        steps[start : start + count] = 0
    arguments = steps, least, apart, int(rng.choice([0, 8])), last
    same(segment_ends(*arguments), in_numpy(segment_ends, *arguments))


@thorough
@given(seeds, st.integers(1, 60), st.integers(0, 40))
def test_segments_that_move(compiled: None, seed: int, n: int, still: int) -> None:
    """Some segments are shorter than a unit, or extrude alone, next to lines of the file."""
    rng = np.random.default_rng(seed)
    places = np.cumsum(rng.normal(0.0, 0.01, (n, 4)) * (rng.random((n, 1)) < 0.5), axis=0)
    places[:, 3] = np.cumsum(rng.uniform(0.0, 0.01, n))
    ends = np.cumsum(rng.integers(1, 40, n))
    forced = rng.random(int(ends[-1]) + 1) < rng.choice([0.0, 0.01, 0.2])
    arguments = places, ends, forced, np.zeros(4, np.int64), still, Units()
    plain = in_numpy(_moving, *arguments)
    for k, found in enumerate(_moving(*arguments)):
        same(np.asarray(found), plain[k])


@thorough
@given(seeds, st.integers(1, 60), st.integers(1, 7), st.integers(0, 5), st.sampled_from([0, 7, -1]))
def test_lines(compiled: None, seed: int, n: int, digits_of: int, places: int, feed: int) -> None:
    rng = np.random.default_rng(seed)
    at = rng.integers(-(10**digits_of), 10**digits_of + 1, (n + 1, 4)) // 10**places * 10**places
    at[1:][rng.random((n, 4)) < 0.3] = at[0, 0]
    arguments = at, rng.integers(0, 5, n), feed, (4, 5, 6, 5, 2)
    text, ends = digits.motion_lines(*arguments)
    plain_text, plain_ends = in_numpy(digits.motion_lines, *arguments)
    assert text == plain_text
    same(ends, plain_ends)
