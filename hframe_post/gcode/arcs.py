"""G2, G3 and G5 as chords within TOLERANCE of the curve.

An arc goes round the centre that the file gives, as firmwares play it. Where the end is not
quite as far from the centre as the start, since slicers round, the radius changes evenly on
the way. Nothing is computed from the distance between start and end, which of a nearly full
circle is small and mostly rounding.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hframe_post.arrays import Array

TOLERANCE = 0.005  # mm between a curve and its chords
RADIUS_MISMATCH = 0.1  # mm by which rounded numbers may miss the end point
SAME = 1e-6  # mm; ends this close are one place, and the arc a full circle
WIDEST = math.pi / 8.0  # rad of a chord, of the smallest arcs too

Point = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Arc:
    """From the angle ``begin`` (rad) over ``sweep`` (rad, positive to the left) round ``centre``.

    radii: at its start and at its end, mm.
    """

    centre: Point
    begin: float
    sweep: float
    radii: tuple[float, float]

    @property
    def length(self) -> float:
        """Its length in the plane, mm."""
        return abs(self.sweep) * sum(self.radii) / 2.0

    def chords(self) -> tuple[Array, Array]:
        """Points after the start (k, 2), and the share of the arc up to each (k,)."""
        sagitta = min(TOLERANCE / max(self.radii), 1.0)
        widest = min(2.0 * math.acos(1.0 - sagitta), WIDEST)
        k = max(math.ceil(abs(self.sweep) / widest), 1)  # 0 where the end lies behind the start
        share = np.arange(1, k + 1) / k
        angle = self.begin + self.sweep * share
        radius = self.radii[0] + (self.radii[1] - self.radii[0]) * share
        turned = np.column_stack([np.cos(angle), np.sin(angle)])
        return np.array(self.centre) + radius[:, None] * turned, share


def arc(start: Point, end: Point, centre: Point, ccw: bool, turns: int = 1) -> Arc | None:
    """The arc between two places round a centre; None where none is.

    turns: begun turns; 2 is once more all the way round. Equal ends make a full circle.
    """
    radii = math.dist(start, centre), math.dist(end, centre)
    if min(radii) == 0.0 or abs(radii[1] - radii[0]) > RADIUS_MISMATCH:
        return None
    begin = math.atan2(start[1] - centre[1], start[0] - centre[0])
    sweep = math.atan2(end[1] - centre[1], end[0] - centre[0]) - begin
    sweep = (sweep if ccw else -sweep) % math.tau
    if math.dist(start, end) < SAME:
        sweep = math.tau
    sweep += math.tau * (turns - 1)
    return Arc(centre, begin, sweep if ccw else -sweep, radii)


def centre_of_radius(start: Point, end: Point, radius: float, ccw: bool) -> Point | None:
    """Centre of an arc given by R; None where it fits no such arc.

    A negative radius asks for the longer way round, as the G-code standard has it.
    """
    half = math.dist(start, end) / 2.0
    if half == 0.0 or half > abs(radius) + RADIUS_MISMATCH / 2.0:
        return None
    height = math.sqrt(max(radius * radius - half * half, 0.0)) / (2.0 * half)
    if (radius < 0.0) == ccw:
        height = -height
    dx, dy = end[0] - start[0], end[1] - start[1]
    return (start[0] + dx / 2.0 - height * dy, start[1] + dy / 2.0 + height * dx)


def spline(start: Point, first: Point, second: Point, end: Point) -> tuple[Array, Array]:
    """Chords of a cubic Bézier curve with two control points; see ``Arc.chords``."""
    p = np.array([start, first, second, end])
    bend = np.hypot(*np.diff(p, 2, axis=0).T).max()
    k = max(math.ceil(math.sqrt(0.75 * bend / TOLERANCE)), 1)  # (1/8)·max|B''|/k², B'' ≤ 6·bend
    t = np.arange(1, k + 1)[:, None] / k
    points = (1 - t) ** 3 * p[0] + 3 * t * (1 - t) * ((1 - t) * p[1] + t * p[2]) + t**3 * p[3]
    lengths = np.hypot(*np.diff(points, axis=0, prepend=p[:1]).T)
    whole = lengths.sum()
    share = np.cumsum(lengths) / whole if whole > 0.0 else np.ones(k)
    return points, share
