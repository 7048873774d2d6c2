"""G2, G3 and G5 as chords within CHORD_ERROR_MM of the curve.

An arc goes round the centre that the file gives, as firmwares play it. Slicers round numbers, so
the end is not quite as far from the centre as the start; the radius changes evenly on the way.
Nothing is computed from the distance between start and end: for a nearly full circle that
distance is small and mostly rounding.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hframe_post.arrays import Array
from hframe_post.gcode.commands import Line, Words
from hframe_post.gcode.state import State
from hframe_post.stream.types import Position

CHORD_ERROR_MM = 0.005  # mm between a curve and its chords
RADIUS_ERROR_MM = 0.1  # mm by which rounded numbers may miss the end point
MAX_COORDINATE_MM = 1e6  # mm; a coordinate beyond this is a corrupted number

Point = tuple[float, float]


def curve(line: Line, name: str, words: Words, state: State, end: Position) -> Array:
    """Return the ends (k, 4) of the chords of G2, G3 or G5; the last one is ``end``.

    An arc makes at most a turn: firmwares ignore P (Marlin unless built with ARC_P_CIRCLES). z and
    e grow in proportion to the length along the curve. Raises GcodeError.
    """
    start = state.position
    i, j, p, q = (words.get(letter, 0.0) * state.scale for letter in "IJPQ")
    first = start[0] + i, start[1] + j
    if name == "G5":
        second = end[0] + p, end[1] + q
        if max(map(abs, (*first, *second))) > MAX_COORDINATE_MM:
            raise line.error("a coordinate is too large")
        points, share = spline(start[:2], first, second, end[:2])
    elif not state.xy_plane:
        raise line.error("arcs outside the x-y plane are not supported")
    else:
        ccw, centre = name == "G3", first if {"I", "J"} & words.keys() else None
        if centre is None and "R" in words:
            centre = centre_of_radius(start[:2], end[:2], words["R"] * state.scale, ccw)
        found = arc(start[:2], end[:2], centre, ccw) if centre else None
        if found is None:
            raise line.error("the arc's centre or radius does not fit its ends")
        if not found.length < MAX_COORDINATE_MM:
            raise line.error("a coordinate is too large")
        points, share = found.chords()
    z, e = (start[axis] + share * (end[axis] - start[axis]) for axis in (2, 3))
    rows = np.column_stack([points, z, e])
    rows[-1] = end
    return rows


# ---------------------------------------------------------------------- arcs


@dataclass(frozen=True, slots=True)
class Arc:
    """An arc from the angle ``begin`` (rad) over ``sweep`` (rad, positive to the left).

    radii: at its start and at its end, mm.
    """

    centre: Point
    begin: float
    sweep: float
    radii: tuple[float, float]

    @property
    def length(self) -> float:
        return abs(self.sweep) * sum(self.radii) / 2.0

    def chords(self) -> tuple[Array, Array]:
        """Return points after the start (k, 2), and the share of the arc up to each (k,)."""
        sagitta = min(CHORD_ERROR_MM / max(self.radii), 1.0)
        # of a radius beyond 1e11 mm the cosine rounds to 1
        angle = max(min(2.0 * math.acos(1.0 - sagitta), math.pi / 8.0), 1e-8)
        k = max(math.ceil(abs(self.sweep) / angle), 1)  # sweep is 0 if the end is behind the start
        share = np.arange(1, k + 1) / k
        angles = self.begin + self.sweep * share
        radius = self.radii[0] + (self.radii[1] - self.radii[0]) * share
        directions = np.column_stack([np.cos(angles), np.sin(angles)])
        return np.array(self.centre) + radius[:, None] * directions, share


def arc(start: Point, end: Point, centre: Point, ccw: bool) -> Arc | None:
    """Return the arc between two points round a centre, or None if the radii do not match.

    Equal ends make a full circle.
    """
    radii = math.dist(start, centre), math.dist(end, centre)
    if min(radii) == 0.0 or abs(radii[1] - radii[0]) > RADIUS_ERROR_MM:
        return None
    begin = math.atan2(start[1] - centre[1], start[0] - centre[0])
    sweep = math.atan2(end[1] - centre[1], end[0] - centre[0]) - begin
    sweep = (sweep if ccw else -sweep) % math.tau
    if math.dist(start, end) < 1e-6:  # mm
        sweep = math.tau
    return Arc(centre, begin, sweep if ccw else -sweep, radii)


def centre_of_radius(start: Point, end: Point, radius: float, ccw: bool) -> Point | None:
    """Return the centre of an arc given by R, or None; R < 0 asks for the longer way round."""
    half = math.dist(start, end) / 2.0
    if half == 0.0 or half > abs(radius) + RADIUS_ERROR_MM / 2.0:
        return None
    height = math.sqrt(max(radius * radius - half * half, 0.0)) / (2.0 * half)
    if (radius < 0.0) == ccw:
        height = -height
    dx, dy = end[0] - start[0], end[1] - start[1]
    return (start[0] + dx / 2.0 - height * dy, start[1] + dy / 2.0 + height * dx)


# ---------------------------------------------------------------------- splines


def spline(start: Point, first: Point, second: Point, end: Point) -> tuple[Array, Array]:
    """Return chords of a cubic Bézier curve with two control points; see ``Arc.chords``."""
    p = np.array([start, first, second, end])
    bend = np.hypot(*np.diff(p, 2, axis=0).T).max()
    k = max(
        math.ceil(math.sqrt(0.75 * bend / CHORD_ERROR_MM)), 1
    )  # (1/8)·max|B''|/k², B'' ≤ 6·bend
    t = np.arange(1, k + 1)[:, None] / k
    points = (1 - t) ** 3 * p[0] + 3 * t * (1 - t) * ((1 - t) * p[1] + t * p[2]) + t**3 * p[3]
    lengths = np.hypot(*np.diff(points, axis=0, prepend=p[:1]).T)
    total = lengths.sum()
    share = np.cumsum(lengths) / total if total > 0.0 else np.ones(k)
    return points, share
