"""Profiles and samples: on the path, within the limits, on the clock, independent of cuts."""

import math
from collections.abc import Iterable
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from ruckig import InputParameter, Ruckig, RuckigError, Trajectory

from hframe_post.arrays import TS, Array, E, Z
from hframe_post.errors import HframeError
from hframe_post.native.planning import profiles
from hframe_post.planner.lookahead import plan
from hframe_post.planner.profiles import Profiler
from hframe_post.planner.sampling import SAMPLES_PER_CHUNK, SPARED, sample
from hframe_post.printer.settings import Limits
from hframe_post.stream.marks import NO_MARKS, Mark
from hframe_post.stream.types import (
    Dwell,
    Event,
    Handling,
    Item,
    MoveAtRest,
    Moves,
    Passthrough,
    Plan,
    Rest,
    Samples,
    StopRules,
)
from tests.mark_tools import each
from tests.planner.planning import (
    LIMITS,
    STATE,
    caps,
    carried,
    integrate,
    jerks,
    line,
    moves,
    one,
    plans,
    random_moves,
    seeds,
)

RESTS = StopRules(before=7, after=3, long_rest=5)
FIRST = 1 + RESTS.long_rest  # samples from where the first motion starts
DRIFT = 1.5e-6  # mm; what a run may miss its end by
BACK = 1e-5  # mm by which Ruckig may step back where speed and length are almost nothing


def sampled(
    items: Iterable[Item],
    limits: Limits = LIMITS,
    rests: StopRules = RESTS,
    size: int = SAMPLES_PER_CHUNK,
) -> list[Samples]:
    return list(sample(plan(items, limits), limits, rests, size))


def whole(blocks: list[Samples]) -> tuple[Array, list[Event]]:
    """Return all samples and all events."""
    return np.concatenate([b.xyze for b in blocks]), [e for b in blocks for e in b.events]


def measured(item: Moves, rate: float = 0.04) -> Moves:
    """Return the moves with filament in proportion to the path, so that e gives the place."""
    steps = np.linalg.norm(np.diff(item.points[:, :E], axis=0), axis=1)
    points = item.points.copy()
    points[:, E] = rate * np.concatenate([[0.0], np.cumsum(steps)])
    return replace(item, points=points)


# ---------------------------------------------------------------------- samples of motion


@settings(max_examples=40, deadline=None)
@given(seeds, st.integers(1, 80), jerks)
def test_samples_follow_the_path_and_end_on_it(seed: int, n: int, jerk: float) -> None:
    item = measured(random_moves(seed, n, marked=0.0))
    xyze, _ = whole(sampled([item], replace(LIMITS, jerk=jerk)))
    assert np.isfinite(xyze).all()
    assert (np.diff(xyze[:, E]) >= -0.04 * DRIFT).all()
    for axis in range(E):
        on_path = np.interp(xyze[:, E], item.points[:, E], item.points[:, axis])
        np.testing.assert_allclose(xyze[:, axis], on_path, atol=1e-8)
    np.testing.assert_array_equal(xyze[:FIRST], np.tile(item.points[0], (FIRST, 1)))
    np.testing.assert_array_equal(xyze[-1], item.points[-1])


def test_straight_move_takes_the_time_of_its_jerk_limited_profile() -> None:
    """100 mm at 100 mm/s: v/a + a/j more than without a change of speed."""
    limits = replace(LIMITS, acceleration=1000.0, jerk=2e4)
    xyze, _ = whole(sampled([moves(line((100, 0, 0, 4)))], limits))
    exact = 100.0 / 100.0 + 100.0 / 1000.0 + 1000.0 / 2e4
    assert len(xyze) - FIRST == math.ceil(exact / TS - 1e-3)


def passing_speeds(item: Moves, limits: Limits) -> Array:
    """Speed at each vertex, (n + 1,), from densely sampled phases."""
    found = []
    for planned in plans([item], limits):
        [(t, j)] = Profiler(limits.jerk).profiles([planned])
        a, v, steps = integrate(t, j, planned.speed[:-1])
        start = planned.s[planned.ends[:-1], None] + np.cumsum(steps, axis=1) - steps
        tau = np.linspace(0.0, 1.0, 200) * t[..., None]
        path = start[..., None] + tau * (
            v[..., None] + tau * (a[..., None] / 2 + tau * j[..., None] / 6)
        )
        speed = v[..., None] + tau * (a[..., None] + tau * j[..., None] / 2)
        order = np.argsort(path.ravel(), kind="stable")
        at = np.interp(planned.s, path.ravel()[order], speed.ravel()[order])
        at[planned.ends] = planned.speed
        found.append(at[:-1])
    return np.concatenate([*found, [0.0]])


def test_no_vertex_far_along_is_passed_faster_than_its_junction_allows() -> None:
    item = random_moves(3, 4000)
    excess = passing_speeds(item, LIMITS) - caps(item) * (1 + 1e-3) - 0.05
    assert excess.max() <= 0.0, f"vertex {int(np.argmax(excess))}: {excess.max():.3g} mm/s over"


# ---------------------------------------------------------------------- marks


def marks_of(blocks: list[Samples]) -> list[Mark]:
    return [e for e in each(whole(blocks)[1]) if isinstance(e, Mark)]


@settings(max_examples=40, deadline=None)
@given(seeds, st.integers(1, 80))
def test_marks_are_at_the_first_sample_from_their_vertex_on(seed: int, n: int) -> None:
    item = measured(random_moves(seed, n, marked=0.4), 1.0)
    limits = replace(LIMITS, extruder_corner_velocity=1e9)
    plain = whole(sampled([replace(item, marks=NO_MARKS)], limits))[0][:, E]
    blocks = sampled([item], limits)
    marks = marks_of(blocks)
    assert [m.text for m in marks] == [m.text for m in item.marks]
    assert all(a.index <= b.index for a, b in pairwise(marks))
    for mark in marks:
        vertex = item.points[int(mark.text), E]
        if int(mark.text) == n:  # passes when the command has come to rest, too
            assert mark.index == len(plain)
            continue
        assert plain[mark.index] >= vertex - DRIFT
        if int(mark.text):
            assert plain[mark.index - 1] <= vertex + DRIFT


def test_pass_through_line_at_rest_is_at_the_present_sample() -> None:
    blocks = sampled([moves(line((5, 0, 0, 0))), Passthrough(2, b"G4", Handling.REST, STATE),
                      carried(b"M106")])  # fmt: skip
    n = len(whole(blocks)[0])
    assert marks_of(blocks) == [Mark(n, b"M106")]


# ---------------------------------------------------------------------- rests and pauses

RETRACT = MoveAtRest(4, (50, 0, 0.2, 2), (50, 0, 0.2, 1.2), 45.0)
YIELD = Passthrough(5, b"G28", Handling.RELEASE, STATE)
DWELL = Passthrough(6, b"G4 P12.5", Handling.REST, STATE, seconds=0.0125)


def there(start: float = 0.0) -> Moves:
    return moves([(start, 0, 0.2, 2), (start + 50, 0, 0.2, 2)])


def test_dwell_lasts_whole_samples_and_keeps_its_exact_time() -> None:
    (pause,) = (e for e in whole(sampled([there(), DWELL]))[1] if isinstance(e, Dwell))
    assert (pause.samples, pause.exact) == (13, 0.0125)


def test_released_machine_ends_its_stretch_and_starts_from_where_the_file_says() -> None:
    blocks = sampled([there(), YIELD, there(70.0)])
    assert [b.ends_stretch for b in blocks].count(True) == 1
    first = next(k for k, b in enumerate(blocks) if b.ends_stretch)
    after = blocks[first + 1]
    assert after.events[0] == Rest(after.first + 1, RESTS.long_rest)
    np.testing.assert_array_equal(after.xyze[0], [70.0, 0, 0.2, 2])


# ---------------------------------------------------------------------- lifts

LIFT = MoveAtRest(7, (50, 0, 0.2, 2), (50, 0, 0.6, 2), 20.0)
PASSING = replace(RESTS, lift_speed=2.0 / SPARED)


def lift_of(
    items: Iterable[Item], rests: StopRules = PASSING, action: MoveAtRest = LIFT
) -> tuple[Dwell, Array, list[Event]]:
    xyze, events = whole(sampled(items, rests=rests))
    (lift,) = (e for e in events if isinstance(e, Dwell) and e.action is action)
    return lift, xyze[lift.index - 1 : lift.index + lift.samples, Z], events


def test_a_lift_passes_from_motion_and_into_it() -> None:
    lift, z, events = lift_of([there(), LIFT, there(50.0)])
    assert [type(e) for e in events] == [Rest, Dwell]  # that at the beginning
    assert lift.entry == lift.leaving == pytest.approx(2.0)
    speed = np.diff(z) / TS
    assert 2.0 <= speed[0] <= 3.0  # and half a millisecond of 1000 mm/s² next to it
    assert 2.0 <= speed[-1] <= 3.0
    assert lift.exact == pytest.approx(lift.samples * TS)  # nothing waits for the sample
    at_rest, z_at_rest, _ = lift_of([there(), LIFT, there(50.0)], RESTS)
    assert (at_rest.entry, at_rest.leaving) == (0.0, 0.0)
    assert lift.samples < at_rest.samples
    assert z[-1] == z_at_rest[-1] == 0.6


@pytest.mark.parametrize(
    ("items", "entry", "leaving"),
    [
        ([there(), RETRACT, LIFT, carried(b"M106 S3"), there(50.0)], 0.0, 2.0),
        ([there(), carried(b"M106 S3"), LIFT, RETRACT, there(50.0)], 2.0, 0.0),
        ([there(), LIFT, DWELL, there(50.0)], 2.0, 0.0),
        ([there(), DWELL, LIFT, YIELD, there(50.0)], 0.0, 0.0),
        ([LIFT, there(50.0)], 0.0, 0.0),  # a stretch begins, for which the command settles
    ],
)
def test_a_lift_next_to_anything_else_rests(
    items: list[Item], entry: float, leaving: float
) -> None:
    lift, _, _ = lift_of(items)
    assert (lift.entry, lift.leaving) == pytest.approx((entry, leaving))


def test_a_long_or_a_combined_lift_comes_to_rest() -> None:
    lift, _, _ = lift_of([there(), LIFT, there(50.0)], replace(PASSING, long_from=20))
    assert (lift.entry, lift.leaving) == (0.0, 0.0)
    primed = replace(LIFT, end=(50, 0, 0.6, 2.1))
    pause, _, _ = lift_of([there(), primed, there(50.0)], action=primed)
    assert (pause.entry, pause.leaving) == (0.0, 0.0)


def standing(start: Array, end: Array, speed: float) -> tuple[Dwell, Array]:
    action = MoveAtRest(1, tuple(start.tolist()), tuple(end.tolist()), speed)
    blocks = sampled([action])
    xyze, events = whole(blocks)
    pause = events[0]
    assert isinstance(pause, Dwell)
    return pause, xyze[pause.index : pause.index + pause.samples]


ORIGIN = np.array([10.0, 20.0, 1.0, 5.0])


def trapezoid(length: float, speed: float, acceleration: float) -> float:
    if length < speed**2 / acceleration:
        return 2.0 * math.sqrt(length / acceleration)
    return length / speed + speed / acceleration


@pytest.mark.parametrize(
    ("dz", "de", "asked", "expected"),
    [
        (0.0, -0.8, 45.0, trapezoid(0.8, 45.0, 2000.0)),
        (0.0, 6.0, 45.0, trapezoid(6.0, 45.0, 2000.0)),
        (0.0, -5.0, 500.0, trapezoid(5.0, 60.0, 2000.0)),
        (0.0, 0.001, 45.0, trapezoid(0.001, 45.0, 2000.0)),
        (0.2, 0.0, 10.0, trapezoid(0.2, 10.0, 500.0)),
        (-5.0, 0.0, 10.0, trapezoid(5.0, 10.0, 500.0)),
        (15.0, 0.0, 300.0, trapezoid(15.0, 20.0, 500.0)),
        (1.0, -6.0, 20.0, trapezoid(1.0, 10.0, 2000.0 / 6.0)),
        # Klipper limits any extrusion in a move without x and y, not retraction alone
        (1.0, 6.0, 20.0, trapezoid(1.0, 10.0, 2000.0 / 6.0)),
    ],
)
def test_standing_move_takes_a_trapezoids_time(
    dz: float, de: float, asked: float, expected: float
) -> None:
    end = ORIGIN + np.array([0.0, 0.0, dz, de])
    pause, xyze = standing(ORIGIN, end, asked)
    assert pause.exact == pytest.approx(expected)
    assert pause.samples == math.ceil(expected / TS - 1e-9)
    np.testing.assert_array_equal(xyze[-1], end)


@given(
    st.floats(-30.0, 30.0).filter(lambda d: abs(d) > 1e-5),
    st.sampled_from([Z, E]),
    st.floats(0.1, 200.0),
)
def test_standing_move_keeps_its_axis_limits(distance: float, axis: int, speed: float) -> None:
    end = ORIGIN.copy()
    end[axis] += distance
    _, xyze = standing(ORIGIN, end, speed)
    path = np.concatenate([[ORIGIN[axis]], xyze[:, axis]])
    steps = np.diff(path) * math.copysign(1.0, distance)
    top, a = (20.0, 500.0) if axis == Z else (60.0, 2000.0)
    assert (steps >= -1e-12).all()
    assert steps.max() <= min(top, speed) * TS * (1 + 1e-9)
    assert np.abs(np.diff(steps)).max(initial=0.0) <= a * TS**2 * (1 + 1e-6)
    assert path[-1] == end[axis]
    others = [k for k in range(4) if k != axis]
    assert (xyze[:, others] == ORIGIN[others]).all()


def test_chunks_stay_short_however_long_the_machine_stands() -> None:
    feeds = [
        MoveAtRest(k, (0, 0, 0, 900.0 * k), (0, 0, 0, 900.0 * (k + 1)), 60.0) for k in range(9)
    ]
    sizes = [len(block) for block in sampled(feeds)]
    assert sum(sizes) > 4 * SAMPLES_PER_CHUNK
    assert max(sizes) < 2 * SAMPLES_PER_CHUNK


# ---------------------------------------------------------------------- single profiles


def shortest(v0: Array, v1: Array, a: Array, jerk: float) -> Array:
    """Return the least path over which v0 becomes v1."""
    change = np.abs(v1 - v0)
    time = np.where(change > a * a / jerk, change / a + a / jerk, 2.0 * np.sqrt(change / jerk))
    return np.asarray(time * (v0 + v1) / 2.0)


def assert_profiles_fit(planned: Plan, jerk: float) -> None:
    [(t, j)] = Profiler(jerk).profiles([planned])
    a, v, steps = integrate(t, j, planned.speed[:-1])
    length = np.diff(planned.s[planned.ends])
    assert (t >= 0.0).all()
    np.testing.assert_allclose(steps.sum(axis=1), length, rtol=0.0, atol=DRIFT)
    end = v[:, -1] + t[:, -1] * (a[:, -1] + t[:, -1] * j[:, -1] / 2.0)
    np.testing.assert_allclose(end, planned.speed[1:], rtol=1e-5, atol=1e-3)
    share = np.linspace(0.0, 1.0, 12) * t[..., None]
    inside = v[..., None] + share * (a[..., None] + share * j[..., None] / 2.0)
    step = share * (v[..., None] + share * (a[..., None] / 2.0 + share * j[..., None] / 6.0))
    path = (np.cumsum(steps, axis=1) - steps)[..., None] + step
    assert np.diff(path.reshape(len(path), -1), axis=1).min() >= -BACK
    top = planned.cruise * (1 + 1e-5) + 1e-3
    assert (inside.max(axis=(1, 2)) <= top).all()
    assert (np.abs(a).max(axis=1) <= planned.acceleration * (1 + 1e-4)).all()
    assert np.abs(j).max() <= jerk * (1 + 1e-9)


@pytest.mark.parametrize("jerk", [5e6, 1e7, 5e7, 1e9])
def test_every_run_between_rests_takes_the_least_time(jerk: float) -> None:
    """v up, along, and down again: L/v + v/a + a/j, at great accelerations, too."""
    rng, n = np.random.default_rng(3), 3000
    a, v = rng.uniform(500.0, 50e3, n), rng.uniform(150.0, 300.0, n)
    a = np.minimum(a, 0.99 * np.sqrt(v * jerk))
    length = (v * v / a + v * a / jerk) * (1.01 + 10.0 ** rng.uniform(-2.0, 2.0, n))
    s, count = np.append(0.0, np.cumsum(length)), np.arange(n + 1)
    points = np.column_stack([s, np.zeros((n + 1, 3))])
    planned = Plan(count[:-1], points, s, count, 0.0 * s, v, a, NO_MARKS)
    [(t, _)] = Profiler(jerk).profiles([planned])
    np.testing.assert_allclose(t.sum(axis=1), np.diff(s) / v + v / a + a / jerk, rtol=1e-6)


@settings(max_examples=50, deadline=None)
@given(seeds, st.integers(1, 100), jerks)
def test_profiles_are_within_limits(seed: int, n: int, jerk: float) -> None:
    assert_profiles_fit(one(random_moves(seed, n), replace(LIMITS, jerk=jerk)), jerk)


def test_closed_forms_take_as_long_as_ruckigs_profiles() -> None:
    """To 0.1 %, the share of a limit that counts as all of it; Ruckig finds no profile for some."""
    rng, n, jerk = np.random.default_rng(1), 2000, 2e7
    v0, v1 = rng.uniform(0.0, 300.0, (2, n)) * (rng.random((2, n)) < 0.7)
    cruise = np.maximum(v0, v1) * (1.0 + rng.random(n) ** 3) + 1e-3
    most = 10.0 ** rng.uniform(2.5, 4.5, n)
    length = shortest(v0, v1, most, jerk)
    length = length * (1.0 + 10.0 ** rng.uniform(-5.0, 2.0, n)) + 1e-3 * rng.random(n)
    t, _, others = profiles(v0, v1, length, cruise, most, jerk)
    solver, problem, trajectory = Ruckig(1), InputParameter(1), Trajectory(1)
    problem.current_position = problem.current_acceleration = problem.target_acceleration = [0.0]
    problem.max_jerk, compared = [jerk], 0
    for k in np.setdiff1d(np.arange(n), others).tolist():
        problem.current_velocity, problem.target_velocity = [v0[k]], [v1[k]]
        problem.target_position, problem.max_velocity = [length[k]], [cruise[k]]
        problem.max_acceleration, problem.min_acceleration = [most[k]], [-most[k]]
        try:
            solver.calculate(problem, trajectory)
        except RuckigError:
            continue
        compared += 1
        assert t[k].sum() <= trajectory.duration * 1.001
    assert compared > 0.7 * n
    assert len(others) > 0.1 * n


def test_end_that_cannot_be_reached_is_an_error_with_its_line() -> None:
    impossible = Plan(
        np.array([41, 42]), np.array([[0.0] * 4, [5.0, 0, 0, 0], [5.1, 0, 0, 0]]),
        np.array([0.0, 5.0, 5.1]), np.array([0, 1, 2]), np.array([0.0, 100.0, 0.0]),
        np.array([100.0, 100.0]), np.array([1e4, 1e4]), NO_MARKS,
    )  # fmt: skip
    with pytest.raises(HframeError, match=r"line 42: no .* fits"):
        Profiler(5e7).profiles([impossible])
