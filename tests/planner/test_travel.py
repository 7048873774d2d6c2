"""Limits of travel and of diagonals, where the profile has them; nothing else changes."""

import math
from dataclasses import replace

import numpy as np
import pytest

from hframe_post.arrays import Array
from hframe_post.model.kinematics import Kinematics
from hframe_post.planner.lookahead import plan
from hframe_post.planner.motors import WithinMotors
from hframe_post.planner.pacing import with_travel_limits
from hframe_post.printer.settings import Limits, Motors
from hframe_post.stream.types import FileLimits, Moves, Plan
from tests.planner.planning import FREE, LIMITS, cut, moves

HARD = 4.0 * LIMITS.acceleration
TRAVEL_LIMITS = replace(LIMITS, travel_velocity=350.0, travel_acceleration=HARD)


def job(limits: FileLimits = FREE) -> Moves:
    """Return: print, travel, print, a wipe of the nozzle, travel with a slope."""
    points = [
        (0, 0, 0.2, 0), (50, 0, 0.2, 2), (90, 0, 0.2, 2), (90, 40, 0.2, 4), (90, 60, 0.2, 4),
        (50, 60, 1.2, 4),
    ]  # fmt: skip
    block = moves(points)
    speed = np.array([50.0, 150.0, 50.0, 20.0, 150.0])
    return replace(block, speed=speed, acceleration=np.full(5, 500.0), limits=limits)


def changed(block: Moves, limits: Limits) -> Moves:
    (one,) = with_travel_limits([block], limits)
    assert isinstance(one, Moves)
    return one


def test_without_limits_of_travel_it_is_as_in_the_file() -> None:
    block = job()
    assert changed(block, LIMITS) is block


def test_travel_gets_its_limits_and_extrusion_does_not() -> None:
    fast = changed(job(), TRAVEL_LIMITS)
    hard = TRAVEL_LIMITS.travel_acceleration
    np.testing.assert_array_equal(fast.acceleration, [500.0, hard, 500.0, hard, hard])
    # what is slower than printing stays, and so does what climbs
    np.testing.assert_array_equal(fast.speed, [50.0, 350.0, 50.0, 20.0, 150.0])


def test_what_the_file_asks_of_travel_alone_lowers_it() -> None:
    asked = FileLimits(FREE.velocity, FREE.acceleration, travel=900.0)
    assert changed(job(asked), TRAVEL_LIMITS).acceleration[1] == 900.0


def test_travel_does_not_depend_on_cuts() -> None:
    whole = changed(job(), TRAVEL_LIMITS)
    pieces = [p for p in with_travel_limits(cut(job(), 1), TRAVEL_LIMITS) if isinstance(p, Moves)]
    assert len(pieces) == 5
    for name in ("speed", "acceleration"):
        column: Array = np.concatenate([getattr(piece, name) for piece in pieces])
        np.testing.assert_array_equal(column, getattr(whole, name))


def test_travel_is_planned_with_its_limits_and_extrusion_is_not() -> None:
    (planned,) = plan([job()], TRAVEL_LIMITS)
    assert isinstance(planned, Plan)
    runs = planned.line[planned.ends[:-1]]
    assert planned.cruise[runs == planned.line[1]].max() == 350.0 > LIMITS.velocity
    assert planned.acceleration[runs == planned.line[1]].max() == TRAVEL_LIMITS.travel_acceleration
    printed = planned.line[0], planned.line[2]
    assert planned.acceleration[np.isin(runs, printed)].max() == 500.0


@pytest.mark.parametrize("asked", [math.inf, 1500.0, 600.0])
@pytest.mark.parametrize("kinematics", ["cartesian", "corexy"])
def test_m201_limits_each_motor(kinematics: str, asked: float) -> None:
    """On a cartesian printer a diagonal has √2 times as much, on a CoreXY as little less."""
    (ax, ay), (bx, by) = Kinematics(kinematics).matrix.tolist()
    own = FileLimits(acceleration=(500.0, 500.0, math.inf, math.inf), belts=((ax, ay), (bx, by)))
    corners = [(0, 0, 0.2, 0), (40, 0, 0.2, 1), (80, 40, 0.2, 2), (80, 80, 0.2, 3)]
    (planned,) = plan([moves(corners, acceleration=asked, limits=own)], LIMITS)
    assert isinstance(planned, Plan)
    line = planned.line[planned.ends[:-1]]
    found = [planned.acceleration[line == k].max() for k in planned.line]
    along = math.sqrt(2.0) if kinematics == "cartesian" else math.sqrt(0.5)
    np.testing.assert_allclose(found, [500.0, min(asked, along * 500.0), 500.0])


def test_what_stated_motors_cannot_follow_is_slower_and_counted() -> None:
    """On a CoreXY a diagonal turns one motor √2 times as fast as a line along x."""
    within = WithinMotors(Motors(120.0, 1e6), Kinematics("corexy"))
    corners = [(0, 0, 0.2, 0), (40, 0, 0.2, 1), (80, 40, 0.2, 2), (120, 40, 0.2, 3)]
    (slower,) = within.items([moves(corners, acceleration=1000.0, corner=1.0)])
    assert isinstance(slower, Moves)
    assert slower.speed.tolist() == pytest.approx([100.0, 120.0 / math.sqrt(2.0), 100.0])
    assert (within.path, within.slowed) == pytest.approx((80.0 + 40.0 * 2**0.5, 40.0 * 2**0.5))
