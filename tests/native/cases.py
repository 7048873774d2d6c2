"""Random inputs of every pair of a loop in C and its numpy twin, hard ones among them.

A case yields calls: a function of ``hframe_post.native``, or one that calls it several times, and
its arguments.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hframe_post.arrays import Array, X, Y, Z
from hframe_post.compensation.guard import Guard
from hframe_post.compensation.stops import StopSolvers
from hframe_post.conversion.pipeline import prepared
from hframe_post.firmware.klipper.ramps import StreamLimits
from hframe_post.firmware.marlin.planner import SteppedPlanner, make_planner
from hframe_post.model.constant_acceleration import Trapezoid
from hframe_post.model.kinematics import Kinematics
from hframe_post.model.nozzle import Filters
from hframe_post.model.stop import StopSolver
from hframe_post.model.stop_cost import Stop, Surroundings
from hframe_post.native import (
    block_times,
    blocks,
    contour,
    decimate,
    digits,
    guard,
    line_width,
    lookahead,
    picture,
    plant,
    ramps,
    sampling,
    segments,
    slow_segments,
    whole_steps,
)
from hframe_post.native.linear import product, recursion, windows_product
from hframe_post.native.plant import LANES, Couplings, Sections
from hframe_post.planner.profiles import Profiler
from hframe_post.prediction.picture import FINEST, LAYER, LINE, NEAR, WAYS
from hframe_post.printer.profile import load
from hframe_post.stream.types import Plan
from hframe_post.studies.simulation.uncertainty import draws
from hframe_post.writers.stream.segments import Units
from tests.coupled import coupled_plant
from tests.native.comparing import copies
from tests.random_paths import walk, wander

Rng = np.random.Generator
Call = tuple[Any, ...]  # a function and its arguments
Case = Callable[[Rng], Iterator[Call]]
paper = cache(lambda: load("paper"))


def size(rng: Rng, most: int) -> int:
    """Return a number from 1 on; the least and the greatest are drawn often."""
    often = rng.choice([1, 2, 3, most])
    return int(often if rng.random() < 0.4 else rng.integers(1, most + 1))


# ---------------------------------------------------------------------- planner


def queue(rng: Rng) -> Iterator[Call]:
    """Some moves are short, steep, or alike; the file may limit axes; jerk may be low."""
    n, power = size(rng, 200), rng.uniform(4.0, 8.0)
    steps = np.repeat(10.0 ** rng.uniform(-3.0, 1.5, (n, 4)), 3, axis=0)[:n]
    steps *= rng.choice([-1.0, 0.0, 1.0], (n, 4), p=[0.3, 0.2, 0.5])
    steps[:, X] += 1e-3 * (steps[:, :Z] == 0.0).all(axis=1)
    steps[:, Z] *= 0.01
    points = np.cumsum(np.vstack([np.zeros(4), steps]), axis=0)
    speed, acceleration, corner = np.repeat(
        rng.uniform(1.0, [[300.0], [3e3], [20.0]], (3, n)), 5, 1
    )[:, :n].copy()
    of_printer = [300.0, 300.0, 1e4, 1e4, 20.0, 60.0, 50.0, 500.0 / 3, 2e3 / 3, 5.0, 0.1]
    of_file = [20.0, np.inf, 20.0, 10.0, np.inf, 500.0, 500.0, np.inf]
    of_file = of_file if rng.random() < 0.5 else [np.inf] * 8
    belts = [1.0, 1.0, 1.0, -1.0] if rng.random() < 0.5 else [1.0, 0.0, 0.0, 1.0]
    rules = np.array([*of_printer, *of_file, *belts])
    yield lookahead.limit_moves, points, speed, acceleration, corner, rules
    moves = lookahead.limit_moves(points, speed, acceleration, corner, rules)
    yield lookahead.greatest_speeds, points, moves, 1.0
    yield lookahead.greatest_speeds, points, moves, 1.0, 1.0
    caps = lookahead.greatest_speeds(points, moves, 1.0)
    last = float(caps[-1]) * rng.choice([0.0, 1.0])
    yield lookahead.find_runs, moves, caps, 10.0**power, 10.0 ** rng.uniform(2.0, 4.0), last


def runs(rng: Rng) -> Iterator[Call]:
    n = size(rng, 30)
    speed = rng.uniform(0.0, 200.0, n + 1) * (rng.random(n + 1) < 0.7)
    length = rng.exponential(5.0, n) + np.abs(np.diff(np.square(speed))) / 1e3
    s = np.concatenate([[0.0], np.cumsum(length)])
    count, limits = np.arange(n + 1), (np.full(n, 250.0), np.full(n, 2e3))
    plan = Plan(count[:-1], np.zeros((n + 1, 4)), s, count, speed, *limits, ())
    [profile] = Profiler(5e6).profiles([plan])
    yield sampling.phases, *profile, speed, s, 0.1234


def changes_of_speed(rng: Rng) -> Iterator[Call]:
    """Some begin or end at rest, some keep their speed, and some lengths are too short."""
    n, jerk = size(rng, 30), 10.0 ** rng.uniform(4.0, 9.0)
    v0, v1 = rng.uniform(0.0, 200.0, (2, n)) * (rng.random((2, n)) < 0.8)
    v1 = np.where(rng.random(n) < 0.2, v0, v1)
    length = 10.0 ** rng.uniform(-3.0, 2.0, n)
    yield sampling.ramps, v0, v1, length, jerk
    t, j, _ = sampling.ramps(v0, v1, length, jerk)
    yield sampling.misses, t, j, v0, length


def samples(rng: Rng) -> Iterator[Call]:
    n, first = size(rng, 40), int(rng.integers(0, 501))
    table = rng.normal(0.0, 10.0, (6, n))
    table[1] = rng.exponential(0.02, n)
    table[0] = np.cumsum(table[1]) - table[1]
    yield sampling.path_lengths, table, first, 400, float(rng.uniform(0.1, 10.0))
    s = np.concatenate([[0.0], np.cumsum(rng.exponential(1.0, n))])
    places = np.sort(rng.uniform(0.0, s[-1], 300)) + rng.normal(0.0, 1e-9, 300)
    places = np.concatenate([np.clip(places, 0.0, s[-1]), s])  # decreasing once, too
    yield sampling.follow, s, rng.normal(0.0, 100.0, (n + 1, 4)), places


def moves_at_rest(rng: Rng) -> Iterator[Call]:
    """Retractions and lifts, from rest or not."""
    length, acceleration = float(rng.uniform(0.01, 5.0)), float(rng.choice([100.0, 2000.0]))
    most = min(40.0, math.sqrt(length * acceleration / 2.0))
    v_s, v_e = np.minimum(rng.uniform(0.0, 30.0, 2) * rng.choice([0, 1], 2), most).tolist()
    way = Trapezoid(length, 40.0, acceleration, v_s, v_e)
    lifts, count = rng.random() < 0.5, sampling.samples_until(way.seconds)
    z, e = (0.3 + length, 9.5) if lifts else (0.3, 10.0 - length)
    ends = np.array([[1.0, 2.0, 0.3, 10.0], [1.0, 2.0, z, e]])
    yield sampling.move_at_rest, way.row, ends, 1, count, count


# ---------------------------------------------------------------------- prediction, compensation


def nozzles(rng: Rng) -> Iterator[Call]:
    n, every, reach = size(rng, 600), int(rng.integers(1, 5)), 24
    path = walk(rng, n)
    at = np.arange(int(rng.integers(0, n)), n, every)
    nozzle = path + rng.normal(0.0, 10.0 ** rng.uniform(-5.0, 0.5), (n, 2))
    yield contour.count_turns, path
    turns, first = contour.count_turns(path), int(at[0])
    yield contour.deviation, path, turns, nozzle[first:], first, at, reach
    yield contour.moving, np.column_stack([path, path]), 1, every


def drawn_lines(rng: Rng) -> Iterator[Call]:
    """Lines with travel, standstill and retractions between them, cut into chunks."""
    n, begun = size(rng, 600), np.zeros(4)
    path = np.column_stack([walk(rng, n), np.zeros(n), np.cumsum(rng.normal(0.01, 0.01, n))])
    nozzle = path[:, :Z] + rng.normal(0.0, 10.0 ** rng.uniform(-5.0, -1.0), (n, 2))
    cuts = [0, *sorted(rng.integers(0, n, 2).tolist()), n - 1]
    laid = rng.normal(0.01, 0.01, n)
    for low, high in pairwise(cuts):
        part = slice(low, high + 1)
        call = path[part], nozzle[part], laid[part], 0.4, begun
        yield line_width.line_pieces, *call
        begun = line_width.line_pieces(*call)[2]


def pieces(rng: Rng) -> Iterator[Call]:
    """Straight pieces are joined; some change their line, layer or feature, or begin anew."""
    n, strategies, coarser = size(rng, 500), int(rng.integers(0, 4)), int(rng.integers(0, 4))
    shape = np.zeros((WAYS + 2 * strategies, n), np.float32)
    shape[:Z], shape[WAYS:] = walk(rng, n).T, 0.002 * rng.normal(size=(2 * strategies, n))
    shape.view(np.int32)[LINE:WAYS] = rng.random((4, n)) < rng.choice([0.0, 0.05, 0.5])
    alike, near = LAYER if coarser else LINE, NEAR * 2.0**coarser
    yield picture.joined_pieces, shape, alike, WAYS, FINEST * 2.0**coarser, near, near / 2.5


def commands(rng: Rng) -> Iterator[Call]:
    """Some have a sample far off, or that is no number, or leave the bed in z; some are safe."""
    n, odd = size(rng, 300), rng.choice([np.nan, np.inf, 0.0, 0.01, 5.0, 300.0])
    path = np.tile([150.0, 80.0, 0.2, 0.0], (n, 1))
    path[:, :2] += walk(rng, n) * rng.choice([1e-3, 1.0])
    command = path[:, :2] + rng.normal(0.0, rng.choice([1e-6, 1e-3]), (n, 2))
    where = path[:, 2:] if rng.random() < 0.5 else command
    where[rng.integers(0, n), 0] += odd
    limits = Guard(paper().travel, paper().motors, paper().kinematics)._limits
    matrix, before = paper().kinematics.matrix, command[:1].repeat(2, axis=0)
    peaks = rng.uniform(0.0, [100.0, 1e4, 1e4, 1e4])
    yield guard.is_safe, path, command, before, limits, matrix, peaks
    yield guard.farthest, path, command


# ---------------------------------------------------------------------- plant


def in_pieces(function: Callable[..., Any], filters: Sections, *calls: Call) -> list[Any]:
    """Call a function with each of some arguments, on from a state of zero."""
    filters = replace(filters, state=np.zeros_like(filters.state))
    return [function(filters, *copies(arguments)) for arguments in calls]


def responses(rng: Rng) -> Iterator[Call]:
    """The nozzle, and what couplings give for the compensation, in pieces of any length."""
    own = paper().plant
    like = int(rng.integers(0, 3))
    chosen = (own.decoupled(), own, coupled_plant(1, racks=True))[like]
    command = (origin := np.array([200.0, 80.0])) + walk(rng, 1000)
    cuts = np.split(command, [1, 40, 40, 700])
    filters = Filters.of_plant(chosen, 0)
    assert filters.fused is not None
    columns = 2 + len(filters.commands)
    pieces = [(filters.couplings, origin, u, np.empty((len(u), columns))) for u in cuts]
    yield in_pieces, plant.response, filters.fused, *pieces
    sections, _ = filters.fused.each()[-1]
    yield plant.filtered, sections, np.zeros((len(sections), 2)), command[:, 0]
    if chosen.couplings:
        in_y = [coupling for coupling in chosen.couplings if coupling.answer == Y]
        added = Filters((), in_y, 0)
        assert added.fused is not None
        calls = [(added.couplings, origin, u - origin, (u[:, 0], u[:, 1])) for u in cuts]
        yield in_pieces, plant.coupled, added.fused, *calls


def lanes(rng: Rng) -> Iterator[Call]:
    own = coupled_plant(1, racks=True) if rng.random() < 0.5 else paper().plant
    count, given = int(rng.integers(1, 8)), int(rng.integers(1, 4))
    drawn = [Filters.of_plant(p, 0) for p in (own, *draws(own, 0.1, LANES - 1, seed=1))]
    groups = -(-count // LANES)
    fused = [f.fused for f in drawn if f.fused is not None]
    table = np.tile(np.stack([each.table for each in fused], axis=-1), (groups, 1, 1, 1))
    centres = np.stack([f.couplings.centres for f in drawn], axis=-1)
    couplings = Couplings(drawn[0].couplings.axes, np.tile(centres, (groups, 1, 1)))
    together = Sections(table, np.zeros((groups, table.shape[1], 2, LANES)), fused[0].counts)
    origin, which = np.array([200.0, 80.0]), rng.integers(0, given, count)
    each = np.stack([origin + walk(rng, 300) for _ in range(given)])
    cuts = (np.ascontiguousarray(u) for u in np.split(each, [1, 100], axis=1))
    calls = [(couplings, origin, u, which) for u in cuts]
    yield in_pieces, plant.responses, together, *calls


def impulse_responses(rng: Rng) -> Iterator[Call]:
    factors = rng.normal(size=size(rng, 300))
    yield plant.sliding_sums, factors, rng.normal(size=len(factors) - 1 + size(rng, 200))
    yield plant.sliding_sums, factors, rng.normal(size=len(factors) - 1)


def matrices(rng: Rng) -> Iterator[Call]:
    m, k, n = size(rng, 12), int(rng.integers(0, 31)), size(rng, 20)
    A, B = rng.normal(size=(m, k)), rng.normal(size=(k, n)) * rng.choice([0.0, 1.0], size=n)
    yield product, A, B
    yield windows_product, rng.normal(size=3 * m + k), int(rng.integers(1, 4)), B
    W = rng.normal(size=(m, n))
    yield recursion, rng.normal(size=(n, n)) / n, W, W[0]


@cache
def solver(coupled: bool) -> StopSolver:
    printer = paper()
    if coupled:
        printer = replace(printer, plant=coupled_plant(1, racks=True))
    return StopSolvers(prepared(printer), ["racking"], printer).at(0.0)["racking"]


def stops(rng: Rng) -> Iterator[Call]:
    """At speeds and next to edges of the bed that need the bounds."""
    a, dwell = 250, int(rng.choice([0, 1, 2, 30, 70, 1000]))
    step = np.repeat(rng.normal(0.0, rng.choice([0.01, 0.1, 0.3]), (40, 2)), 20, axis=0)
    step += rng.normal(0.0, 0.01, step.shape) * rng.choice([0.0, 1.0])
    step[a : a + dwell] = 0.0
    path = np.concatenate([np.cumsum(step, axis=0), np.tile(step.sum(axis=0), (dwell, 1))])
    around = Surroundings(path, rng.choice([0.5, 100.0], 2), rng.random(len(path)) < rng.random())
    before, after = rng.integers(0, 101, 2).tolist()
    movable = dwell > 0 and rng.random() < 0.5
    stop = Stop(a, a + dwell, before, after, movable, a + dwell + after + 1)
    own = solver(bool(rng.random() < 0.5))
    known = own.around.at_rest(np.zeros(2), around.origin)
    known.run(path[: a - 100])
    yield own.solve, around, path, known, stop


# ---------------------------------------------------------------------- writer


def motions(rng: Rng) -> Iterator[Call]:
    """Rounded points have many chords with equal errors."""
    n, tolerance = size(rng, 400), float(rng.uniform(1e-3, 0.1))
    points, forced = wander(int(rng.integers(0, 2**32)), n, rng.uniform(-6.0, -1.0))
    points = points.round(3) if rng.random() < 0.5 else points
    yield decimate.breakpoints, points, forced, tolerance
    yield decimate.fitted, points, decimate.breakpoints(points, forced, tolerance)


def thick_segments(rng: Rng) -> Iterator[Call]:
    """Some segments extrude ten times as much as the others, and some are at rest."""
    ends = np.cumsum(rng.integers(1, 40, size(rng, 60)))
    steps = rng.uniform(0.0, 0.1, (int(ends[-1]) + 1, 4)) * (1.0, 1.0, 0.0, 0.04)
    lays = rng.random() < rng.choice([0.0, 0.3, 1.0])
    steps[:, 3] *= np.where(rng.random(len(steps)) < 0.1, 10.0, 1.0) * lays
    steps[:, :3] *= rng.random((len(steps), 1)) < rng.choice([0.1, 1.0])
    yield decimate.too_thick, np.cumsum(steps, axis=0), ends


def ramped_segments(rng: Rng) -> Iterator[Call]:
    """Some segments are straight on or straight back, and some are too short for their time."""
    k, power, lifts = size(rng, 300), rng.uniform(-4.0, 1.0), rng.random() < 0.5
    limits = StreamLimits.from_limits(paper().limits, paper().motors, paper().kinematics).row
    moves = rng.normal(0.0, 10.0**power, (k, 4)).round(3) * (1.0, 1.0, lifts, 0.04)
    moves[rng.random(k) < 0.2] = moves[0] * rng.choice([1.0, -1.0])
    moves[:, 0] = np.where(moves[:, 0] == 0.0, 0.001, moves[:, 0])
    at = np.cumsum(np.vstack([np.zeros(4), moves]), axis=0)
    T: Array = 1e-3 * np.ceil(rng.uniform(0.0, 200.0, k))
    rest, before = rng.random(k + 1) < rng.choice([0.0, 0.1]), float(rng.choice([0.0, 60.0]))
    yield ramps.klipper_feeds, at, T, rest, before, np.inf, limits, 600.0
    v = rng.uniform(0.1, 700.0, k)
    yield ramps.klipper_durations, at, v, rest, before, np.inf, limits


def stepped(rng: Rng, hz: float, *builds: str) -> SteppedPlanner:
    """Return the planner of a generation with S-curves, with classic jerk, or without both."""
    generation, *options = str(rng.choice(builds)).split()
    timer = block_times.Timer(hz, bool(rng.random() < 0.5), float(rng.choice([0.0, 4e4])))
    planner = make_planner(generation, timer, "jerk" in options, "curved" in options)
    assert isinstance(planner, SteppedPlanner)
    return planner


def single_blocks(rng: Rng) -> Iterator[Call]:
    """Some blocks are too short for their ramps, and some begin or end at their own rate."""
    k, hz = size(rng, 40), float(rng.choice([2e6, 1e15]))
    n = np.ceil(10.0 ** rng.uniform(0.0, 2.5, k))
    rate = np.ceil(10.0 ** rng.uniform(1.0, 4.5, k))
    begin, end = rate * np.minimum(rng.uniform(0.0, 1.5, (2, k)), 1.0)
    each = blocks.Blocks(n, n * 0.0025, 10.0 ** rng.uniform(4.0, 7.0, k))
    stepper = stepped(rng, hz, "2.0", "2.1", "2.1 curved", "2.1-dev").stepper
    yield block_times.block_times, each, begin, rate, end, stepper


def joined_blocks(rng: Rng) -> Iterator[Call]:
    """Some blocks are too short for their time, and some turn back."""
    k = size(rng, 300)
    planner = stepped(rng, 2e6, "2.0", "2.1", "2.1 curved", "2.1 jerk", "2.1-dev")
    n = np.ceil(10.0 ** rng.uniform(0.0, 2.0, k))
    d, T = n * rng.uniform(0.0025, 0.0125, k), 1e-3 * np.ceil(10.0 ** rng.uniform(0.0, 2.0, k))
    corners = np.where(rng.random(k + 1) < 0.2, rng.uniform(0.0, 50.0, k + 1), np.inf)
    each = blocks.Blocks(n, d, 10.0 ** rng.uniform(4.0, 7.0, k), corners)
    before, v = float(rng.choice([0.0, 60.0])), np.ceil(60.0 * d / T) / 60.0
    yield planner.possible_times, each, T, before
    yield planner.feed_rates, each, T, before
    yield planner.durations, each, v, before


def moves_in_steps(rng: Rng) -> Iterator[Call]:
    """Some blocks rest in x and y, some in all, and some turn straight back."""
    k, deviation = size(rng, 40), float(rng.choice([0.3, np.inf]))
    moves = rng.normal(0.0, 1.0, (k, 4)) * (rng.random((k, 4)) < rng.choice([0.5, 0.9]))
    moves[rng.random(k) < 0.2] = moves[0] * rng.choice([1.0, -1.0])
    at = np.cumsum(np.vstack([np.zeros(4), moves]), axis=0)
    limits = blocks.BlockLimits(0.0125, 0.0025, 0.0024, 3e4, 100.0, 6e3, 5e3, deviation)
    matrix = Kinematics(str(rng.choice(["corexy", "cartesian"]))).matrix
    yield blocks.blocks_between, at, float(rng.choice([30.0, np.inf])), limits, matrix


def motor_steps(rng: Rng) -> Iterator[Call]:
    """Motors chatter about their places, turn a few steps apart, and rest."""
    n = size(rng, 600)
    speed = rng.uniform(0.0, 4.0) * np.sin(np.arange(n)[:, None] * rng.uniform(0.0, 0.3, 2))
    steps = np.rint(speed + rng.normal(0.0, rng.choice([0.1, 0.6]), (n, 2))).astype(np.int64)
    first, many = rng.integers(0, n, 4), rng.integers(0, 60, 4)
    for start, count in zip(first.tolist(), many.tolist(), strict=True):
        steps[start : start + count] = 0
    least, apart, stall = int(rng.integers(0, 9)), int(rng.integers(1, 7)), int(rng.choice([0, 8]))
    yield whole_steps.segment_ends, steps, least, apart, stall, bool(rng.random() < 0.5)


def slow_motion(rng: Rng) -> Iterator[Call]:
    """Motion as slow as a step in several samples; it turns, and rests now and then."""
    n, hz = size(rng, 400), rng.uniform(0.0, 30.0, 2)
    t = 1e-3 * np.arange(n + 1)[:, None]
    points = (
        rng.uniform(0.0, 40.0, 2) * np.sin(2.0 * np.pi * hz * t) + rng.uniform(-1e3, 1e3, 2) * t
    )
    points[: int(rng.integers(0, n + 1))] *= rng.choice([0.0, 1.0])
    cells = np.rint(points).astype(np.int64)
    matrix = Kinematics(str(rng.choice(["corexy", "cartesian"]))).matrix
    motors = whole_steps.motor_places(cells, matrix)
    least, apart = int(rng.integers(1, 9)), int(rng.integers(1, 7))
    ends = whole_steps.segment_ends(np.diff(motors, axis=0), least, apart, 8, rng.random() < 0.5)
    yield slow_segments.slow_segment_ends, points, cells, motors, ends, least, apart


def rounded_segments(rng: Rng) -> Iterator[Call]:
    """Some segments are shorter than a unit, or extrude alone, next to lines of the file."""
    n, still = size(rng, 60), int(rng.integers(0, 41))
    places = np.cumsum(rng.normal(0.0, 0.01, (n, 4)) * (rng.random((n, 1)) < 0.5), axis=0)
    places[:, 3] = np.cumsum(rng.uniform(0.0, 0.01, n))
    ends = np.cumsum(rng.integers(1, 40, n))
    forced = rng.random(int(ends[-1]) + 1) < rng.choice([0.0, 0.01, 0.2])
    start: NDArray[np.int64] = np.zeros(4, np.int64)
    yield segments.motion_segments, places, ends, forced, start, still, Units().per_mm


def lines(rng: Rng) -> Iterator[Call]:
    n, digits_of, places = size(rng, 60), int(rng.integers(1, 8)), int(rng.integers(0, 6))
    at = rng.integers(-(10**digits_of), 10**digits_of + 1, (n + 1, 4)) // 10**places * 10**places
    at[1:][rng.random((n, 4)) < 0.3] = at[0, 0]
    feed = int(rng.choice([0, 7, -1]))
    yield digits.motion_lines, at, rng.integers(0, 5, n), feed, (4, 5, 6, 5, 2)


CASES: dict[Case, tuple[str, ...]] = {
    queue: ("limit_moves", "junctions", "find_runs"),
    runs: ("phases",),
    changes_of_speed: ("ramps", "misses"),
    samples: ("path_lengths", "follow"),
    moves_at_rest: ("move_at_rest",),
    nozzles: ("count_turns", "deviation", "moving"),
    drawn_lines: ("line_pieces",),
    pieces: ("joined_pieces",),
    commands: ("safe", "farthest"),
    responses: ("filtered", "response", "coupled"),
    lanes: ("responses",),
    impulse_responses: ("sliding_sums",),
    matrices: ("product", "recursion"),
    stops: ("least_squares",),
    motions: ("breakpoints", "fitted"),
    thick_segments: ("too_thick",),
    ramped_segments: ("klipper_feeds", "klipper_durations"),
    single_blocks: ("marlin_block_times",),
    joined_blocks: ("marlin_times", "marlin_feed_rates"),
    moves_in_steps: ("marlin_blocks",),
    motor_steps: ("marlin_segment_ends",),
    slow_motion: ("marlin_slow_ends",),
    rounded_segments: ("motion_segments",),
    lines: ("motion_lines",),
}
