"""Limits of motors: M201 in a file, and those that a profile states."""

import math

import numpy as np
import pytest

from hframe_post.model.kinematics import Kinematics
from hframe_post.planner.lookahead import plan
from hframe_post.planner.motors import WithinMotors
from hframe_post.printer.settings import Motors
from hframe_post.stream.types import FileLimits, Moves, Plan
from tests.planner.planning import LIMITS, moves


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
