"""Arcs and splines: around the centre and to the end that the file gives."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hframe_post.arrays import Array
from hframe_post.gcode import curves
from hframe_post.stream.types import Moves
from tests.gcode.reading import ends, items

Point = tuple[float, float]

SHARES = st.one_of(  # of a full circle: ordinary, half, quarter, nearly full, tiny
    st.floats(0.001, 0.999),
    st.sampled_from([0.5, 0.25, 0.75, 1.0 - 1e-4, 1.0 - 1e-5, 1.0 - 1e-6, 1e-4]),
)


def rounded(point: Point) -> Point:
    return round(point[0], 3), round(point[1], 3)


def off_circle(points: Array, start: Point, centre: Point) -> float:
    """Return the largest distance of chords, at ends and middles, from the circle."""
    whole = np.vstack([start, points])
    both = np.vstack([whole, (whole[1:] + whole[:-1]) / 2])
    return float(np.abs(np.hypot(*(both - centre).T) - math.dist(start, centre)).max())


def turned(points: Array, start: Point, centre: Point) -> float:
    """Return the number of turns that the chords make round a centre."""
    angle = np.arctan2(*(np.vstack([start, points]) - centre).T[::-1])
    return float((np.diff(np.unwrap(angle)) / math.tau).sum())


@given(st.floats(0.05, 300.0), SHARES, st.floats(0.0, math.tau), st.booleans())
def test_arcs_with_rounded_numbers_keep_their_centre(
    radius: float, share: float, angle: float, ccw: bool
) -> None:
    sweep = math.tau * share * (1 if ccw else -1)
    start = rounded((100 + radius * math.cos(angle), 100 + radius * math.sin(angle)))
    end = rounded((100 + radius * math.cos(angle + sweep), 100 + radius * math.sin(angle + sweep)))
    offset = rounded((100 - start[0], 100 - start[1]))
    centre = start[0] + offset[0], start[1] + offset[1]
    arc = curves.arc(start, end, centre, ccw)
    assert arc is not None
    points, shares = arc.chords()
    assert points[-1] == pytest.approx(end, abs=1e-9)
    assert (shares[-1], shares[0] > 0.0) == (1.0, True)
    assert (
        off_circle(points, start, centre)
        <= curves.CHORD_ERROR_MM + abs(np.diff(arc.radii))[0] + 1e-9
    )
    if radius * math.tau * min(share, 1.0 - share) > 0.01:  # else rounding decides which way
        assert turned(points, start, centre) == pytest.approx(sweep / math.tau, abs=0.01 / radius)


@pytest.mark.parametrize(
    ("line", "centre", "middle"),
    [
        ("G2 X10 Y0 R5", (5, 0), (5, 5)),
        ("G3 X10 Y0 R5", (5, 0), (5, -5)),
        ("G2 X10 Y0 I5 J0", (5, 0), (5, 5)),
        ("G3 X10 Y0 R-13", (5, -12), (5, -25)),
        ("G2 X6 Y0 R-5", (3, 4), (3, 9)),
    ],
)
def test_arcs(line: str, centre: tuple[float, float], middle: tuple[float, float]) -> None:
    points = np.array(ends(line))[:, :2]
    assert off_circle(points, (0.0, 0.0), centre) <= curves.CHORD_ERROR_MM + 1e-9
    assert np.hypot(*(points - middle).T).min() < 0.5


def test_full_circle_and_helix_in_proportion() -> None:
    points = np.array(ends("G3 X0 Y0 Z2 I-10 J0 E4"))
    assert off_circle(points[:, :2], (0.0, 0.0), (-10.0, 0.0)) <= curves.CHORD_ERROR_MM + 1e-9
    assert points[-1].tolist() == [0, 0, 2, 4]
    np.testing.assert_allclose(points[:, 3], 2 * points[:, 2], atol=1e-9)
    assert points[:, 0].min() == pytest.approx(-20, abs=0.05)


@pytest.mark.parametrize("ignored", ["", "P1", "P3", "P1.5", "K7"])
def test_an_arc_makes_at_most_a_turn(ignored: str) -> None:
    """As Klipper's gcode_arcs plays it, and Marlin without ARC_P_CIRCLES."""
    rows = np.array(ends(f"G3 X20 Y0 Z5 I10 J0 E8 {ignored}"))
    assert turned(rows[:, :2], (0.0, 0.0), (10.0, 0.0)) == pytest.approx(0.5)
    assert rows[-1].tolist() == [20, 0, 5, 8]
    np.testing.assert_allclose(rows[:, 3] / 8, rows[:, 2] / 5)


def test_a_spiral_lift_is_one_turn() -> None:
    """As OrcaSlicer writes it: no X, no Y."""
    rows = np.array(ends("G17", "G3 Z.8 I.044 J-1.216 P1 F30000"))
    assert turned(rows[:, :2], (0.0, 0.0), (0.044, -1.216)) == pytest.approx(1.0)
    assert rows[-1].tolist() == [0, 0, 0.8, 0]


def test_arcs_from_an_unknown_position_pass_through() -> None:
    found = items("M83", "G28", "G3 Z.8 I.044 J-1.216 P1 F30000", "G1 X10 Y10 Z.8", "G1 X20 E1")
    (block,) = (item for item in found if isinstance(item, Moves))
    assert block.points[0].tolist() == [10, 10, 0.8, 0]


def bezier(p: Array, t: Array) -> Array:
    u = 1.0 - t[:, None]
    v = t[:, None]
    return np.asarray(u**3 * p[0] + 3 * u * u * v * p[1] + 3 * u * v * v * p[2] + v**3 * p[3])


PLACES = st.tuples(st.floats(-50.0, 50.0), st.floats(-50.0, 50.0))


@given(PLACES, PLACES, PLACES, PLACES)
def test_splines_stay_within_the_tolerance(a: Point, b: Point, c: Point, d: Point) -> None:
    points, share = curves.spline(a, b, c, d)
    assert points[-1] == pytest.approx(d, abs=1e-9)
    assert share[-1] == pytest.approx(1.0)
    whole = np.vstack([a, points])
    k = len(points)
    middles = bezier(np.array([a, b, c, d]), (np.arange(k) + 0.5) / k)
    chords = (whole[1:] + whole[:-1]) / 2
    assert np.hypot(*(middles - chords).T).max() <= curves.CHORD_ERROR_MM * 1.001


def test_g5_has_control_points_relative_to_its_ends() -> None:
    rows = np.array(ends("G1 X10 Y10", "G5 X30 Y10 I5 J20 P-5 Q20 Z1 E3"))[1:]
    expected = bezier(np.array([(10, 10), (15, 30), (25, 30), (30, 10)]), np.linspace(0, 1, 401))
    gap = np.hypot(*(rows[:, None, :2] - expected[None]).transpose(2, 0, 1)).min(axis=1)
    assert gap.max() < 0.1
    assert rows[-1].tolist() == [30, 10, 1, 3]
    assert rows[:, 1].max() == pytest.approx(25.0, abs=0.01)
