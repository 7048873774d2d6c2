"""Look-ahead: Klipper's junctions, limits of moves, reachable speeds, independence of cuts."""

import math
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hframe_post.arrays import Array
from hframe_post.native.planning import greatest_speeds
from hframe_post.planner.lookahead import plan
from hframe_post.planner.sliced import ShortMoves
from hframe_post.printer.settings import Limits
from hframe_post.stream.marks import Mark
from hframe_post.stream.types import (
    FileLimits,
    Moves,
    Plan,
)
from tests.planner.planning import (
    INF,
    LIMITS,
    caps,
    cut,
    gentle_spiral,
    jerks,
    line,
    moves,
    one,
    plans,
    random_moves,
    seeds,
)


def corner_speed(points: Array, limits: Limits = LIMITS, corner: float = INF) -> float:
    """Return the speed at the only corner of two moves."""
    planned = one(moves(points, corner=corner), limits)
    assert planned.ends.tolist() == [0, 1, 2]
    return float(planned.speed[1])


SQUARE = line((100, 0, 0, 0), (0, 100, 0, 0))


DEVIATION = math.sqrt(0.5) / (1.0 - math.sqrt(0.5)) * 5e-4  # mm of radius, for 0.5 µm
STEEP, FLAT = (1, 0, 1.1, 0), (50, 0, 0, 0)
CORNERS: list[tuple[Array, dict[str, float], float, float]] = [
    (SQUARE, {}, INF, 5.0),
    (SQUARE, {}, 2.0, 2.0),  # the file lowers it and never raises it
    (SQUARE, {}, 20.0, 5.0),
    (SQUARE, {"junction_deviation": 5e-4}, INF, math.sqrt(DEVIATION * 1e4)),
    (SQUARE, {"junction_deviation": 0.1}, INF, 5.0),
    (line((100, 0, 0, 0), (-100, 0, 0, 0)), {}, INF, 0.0),
    (line((0.05, 0, 0, 0), (0, 0.05, 0, 0)), {"square_corner_velocity": 100.0}, INF,
     math.sqrt(0.5 * 0.05 * 1e4)),  # its arc must fit
    (line((100, 0, 0, 5), (100, 0, 0, 0)), {}, INF, 1.0 / 0.05),  # of the extruder
    (line(STEEP, FLAT), {}, INF, 0.0), (line(FLAT, STEEP), {}, INF, 0.0),
]  # fmt: skip


@pytest.mark.parametrize(("points", "own", "of_file", "speed"), CORNERS)
def test_corners(points: Array, own: dict[str, float], of_file: float, speed: float) -> None:
    limits = replace(LIMITS, **own)
    assert corner_speed(points, limits, of_file) == pytest.approx(speed)


def test_straight_on_at_another_feed_is_passed_at_the_lower_one() -> None:
    straight = moves(line((50, 0, 0, 0), (50, 0, 0, 0)), np.array([100.0, 40.0]))
    assert one(straight).speed[1] == pytest.approx(40.0, rel=2e-4)
    assert one(straight).speed[1] <= 40.0


@pytest.mark.parametrize(
    ("axis", "step", "share"),
    [
        (0, (30, 40, 0, 0), 0.6),
        (1, (30, -40, 0, 0), 0.8),
        (2, (40, 0, 0.3, 0), 0.3 / math.hypot(40, 0.3)),
        (3, (40, 0, 0, 1), 1 / 40),
    ],
)
def test_axis_limits_of_the_file_lower_the_move(
    axis: int, step: tuple[float, float, float, float], share: float
) -> None:
    velocity, acceleration = [INF] * 4, [INF] * 4
    velocity[axis], acceleration[axis] = 50.0 * share, 600.0 * share
    asked = FileLimits(tuple(velocity), tuple(acceleration))  # type: ignore[arg-type]
    planned = one(moves(line(step), 300.0, limits=asked))
    assert planned.cruise[0] == pytest.approx(50.0)
    assert planned.acceleration[0] == pytest.approx(600.0)


# ---------------------------------------------------------------------- whole plans


@settings(max_examples=60, deadline=None)
@given(seeds, st.integers(1, 120), jerks)
def test_plan_can_be_driven(seed: int, n: int, jerk: float) -> None:
    """Within the caps of corners and lines; ``test_sampling`` drives it."""
    whole = random_moves(seed, n)
    planned = one(whole, replace(LIMITS, jerk=jerk))
    v, ends = planned.speed, planned.ends
    assert v[0] == v[-1] == 0.0
    assert ends[0] == 0
    assert ends[-1] == n
    assert (np.diff(ends) > 0).all()
    assert (v <= caps(whole)[ends] * (1 + 1e-6)).all()
    assert (v[:-1] <= planned.cruise).all()
    assert (v[1:] <= planned.cruise).all()


# ---------------------------------------------------------------------- cutting


def assert_continuous(planned: list[Plan], whole: Moves) -> None:
    np.testing.assert_array_equal(np.concatenate([p.line for p in planned]), whole.line)
    assert planned[0].speed[0] == planned[-1].speed[-1] == 0.0
    for one_plan, following in pairwise(planned):
        assert one_plan.speed[-1] == following.speed[0]
        np.testing.assert_array_equal(one_plan.points[-1], following.points[0])
    first, marks = 0, []
    for p in planned:
        marks += [Mark(m.index + first, m.text) for m in p.marks]
        first += len(p.line)
    assert marks == list(whole.marks)


def slow_giant(n: int) -> Moves:
    """Return a gentle spiral, so fast that braking takes thousands of moves."""
    return replace(gentle_spiral(n, 500.0, 0.05, 300.0), acceleration=np.full(n, 100.0))


def test_smooth_path_of_any_length_is_driven_without_a_stop() -> None:
    """A vase of 70 000 small moves with no corner: the queue is bounded, the motion is not."""
    planned = plans(cut(gentle_spiral(70_000), 10_000))
    inside = np.concatenate([p.speed for p in planned])[1:-1]
    assert (inside > 0.99 * 60.0).all()


def test_no_more_moves_wait_than_the_longest_queue() -> None:
    """Where braking takes longer than the queue, half of it goes as soon as it is full."""
    waiting, done = list[int](), 0

    def one_by_one() -> Iterator[Moves]:
        for k, move in enumerate(cut(slow_giant(300), 1)):
            waiting.append(k + 1 - done)  # with this move
            yield move

    for planned in plan(one_by_one(), LIMITS, batch=16, longest=64):
        assert isinstance(planned, Plan)
        done += len(planned.line)
    assert max(waiting) == 64, "moves in the queue"


def run_ends(planned: list[Plan]) -> dict[int, float]:
    """Return vertex → speed there, for every end of a run."""
    first = 0
    found: dict[int, float] = {}
    for p in planned:
        found |= dict(zip((first + p.ends).tolist(), p.speed.tolist(), strict=True))
        first += len(p.line)
    return found


def test_batches_give_the_speeds_of_one_plan() -> None:
    whole = random_moves(3, 3000)
    parts = plans([whole], batch=50)
    assert_continuous(parts, whole)
    at_once, in_parts = run_ends(plans([whole])), run_ends(parts)
    common = at_once.keys() & in_parts.keys()
    assert len(common) > 0.99 * len(in_parts)
    for vertex in common:
        assert in_parts[vertex] == pytest.approx(at_once[vertex], rel=1e-6, abs=1e-4)


def test_boards_leave_out_moves_of_too_few_steps() -> None:
    """Where only they move, the next begins at their start; whatever line they come from."""
    short = ShortMoves(6, (0.0125, 0.0125, 0.0025, 0.01), np.diag([80.0, 80.0, 400.0, 100.0]))
    steps = (10, 0, 0, 0), (0.05, 0, 0, 0), (0.05, 0, 0, 0), (0.01, 0, 0, 0), (10, 0, 0, 0)
    (joined,) = short.joined_travel([moves(line(*steps))])
    assert isinstance(joined, Moves)
    assert joined.points[:, 0].tolist() == pytest.approx([0.0, 10.0, 10.1, 20.11])


@pytest.mark.parametrize(("turn", "fits"), [(90.0, False), (40.0, True)])
def test_boards_fit_arcs_into_short_gentle_turns_only(turn: float, fits: bool) -> None:
    """As Marlin: its corner of 90° is as fast between short moves as between long ones."""
    angle, a, deviation, length = np.radians(turn), 500.0, 0.08, 0.2
    way = length * np.array([[1.0, 0.0], [np.cos(angle), np.sin(angle)]])
    points = np.column_stack([np.cumsum(np.vstack([[0.0, 0.0], way]), axis=0), np.zeros((3, 2))])
    table = np.tile([length, 300.0, a, deviation, 0.0], (2, 1))
    rules = np.full(21, np.inf)
    rules[-4:] = 1.0, 0.0, 0.0, 1.0
    half = (np.pi - angle) / 2.0  # of the angle between the moves
    arc = np.sqrt(deviation * a * np.sin(half) / (1.0 - np.sin(half)))
    within = np.sqrt(0.5 * length * a * np.tan(half))
    assert within < arc
    klipper, marlin = (
        greatest_speeds(points, table, rules, 1.0, joins, 1.0, 0.0)[0][1] for joins in (False, True)
    )
    assert klipper == pytest.approx(within)
    assert marlin == pytest.approx(np.sqrt(length * a / angle) if fits else arc)
