"""Moves that motors can follow: the extruder its advance, belts M201 and what an owner states."""

import math
from dataclasses import replace

import numpy as np
import pytest

from hframe_post.arrays import E, X
from hframe_post.conversion.options import Options
from hframe_post.conversion.whole_file import WholeFile
from hframe_post.firmware.dialect import Advance, ExtruderLimits, marlin_advance
from hframe_post.model.kinematics import Kinematics
from hframe_post.planner.lookahead import plan
from hframe_post.planner.motors import LOWEST, FollowedAdvance, WithinMotors
from hframe_post.printer.profile import load
from hframe_post.printer.settings import Extruder, Motors
from hframe_post.stream.marks import Mark, Marks
from hframe_post.stream.types import FileLimits, Handling, Item, Moves, Passthrough, Plan
from hframe_post.studies.tuning import rectangle
from tests.planner.planning import LIMITS, STATE, moves
from tests.quantities import below

OF_EXTRUDER = ExtruderLimits(40.0, 2000.0)
GROWS = 0.8 * 2000.0 * 0.01  # mm/s of advance, averaged over 10 ms before and after


def line(per_mm: list[float], acceleration: float = 8000.0, *marks: Mark) -> Moves:
    """Return moves of 10 mm along x with this filament in each mm."""
    points = np.zeros((len(per_mm) + 1, 4))
    points[1:, X] = 10.0 * np.arange(1, len(per_mm) + 1)
    points[1:, E] = np.cumsum(10.0 * np.array(per_mm))
    return moves(points, acceleration=acceleration, marks=Marks.from_lines(marks))


def followed(K: float, *items: Item) -> list[Item]:
    return list(FollowedAdvance(Advance(K, 0.04, marlin_advance), OF_EXTRUDER, 1e4).items(items))


def accelerations(items: list[Item]) -> list[float]:
    return [a for item in items if isinstance(item, Moves) for a in item.acceleration.tolist()]


def test_lines_accelerate_as_their_filament_allows_and_travel_as_asked() -> None:
    found = accelerations(followed(0.1, line([0.03, 0.0, 0.06, -0.01, 0.001])))
    wanted = [GROWS / (0.1 * 0.03), 8000.0, GROWS / (0.1 * 0.06), 8000.0, 8000.0]
    np.testing.assert_allclose(found, wanted)


def test_the_profile_limits_what_the_file_leaves_open() -> None:
    stage = FollowedAdvance(Advance(0.03, 0.04, marlin_advance), OF_EXTRUDER, 1e4)
    found = accelerations(list(stage.items([line([0.03, 0.06], np.inf)])))
    np.testing.assert_allclose(found, [np.inf, GROWS / (0.03 * 0.06)])
    assert stage.share == 0.5
    assert stage.least == found[1]


def test_a_strange_advance_takes_no_more_than_three_quarters() -> None:
    assert accelerations(followed(9.0, line([0.03]))) == [LOWEST * 8000.0]


def test_lines_of_the_file_change_it() -> None:
    stop = Passthrough(0, b"M900 K0.1", Handling.REST, STATE)
    plain, marks = line([0.03]), (Mark(1, b"M900 K0.2"), Mark(2, b"M900 K0"))
    marked = line([0.03, 0.03, 0.03], 8000.0, *marks)
    first, stopped, second = followed(0.0, plain, stop, marked)
    assert (first, stopped) == (plain, stop)
    np.testing.assert_allclose(accelerations([second]), [GROWS / 0.003, GROWS / 0.006, 8000.0])


@pytest.mark.parametrize("K", [0.05, 0.1])
def test_the_line_is_even_where_the_extruder_would_be_outrun(K: float) -> None:
    printer = replace(load("paper-marlin"), extruder=Extruder(K))
    stream = WholeFile(rectangle(printer), printer, Options("racking", ("racking",)))
    assert len(list(stream.samples()))
    below(stream.report.width["racking"].rms, 0.05, "RMS error of the width")


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
