"""G2 and G3 as chords."""

from __future__ import annotations

import math

import numpy as np

from hframe_post.arrays import Array

TOLERANCE = 0.005  # mm between an arc and its chords
RADIUS_MISMATCH = 0.1  # mm by which rounded I and J may miss the end point

Point = tuple[float, float]


def centre(
    start: Point, end: Point, offset: Point | None, radius: float | None, ccw: bool
) -> Point | None:
    """Centre of an arc given by I, J (``offset``) or by R; None where it fits no such arc.

    A negative radius asks for the longer way round, as the G-code standard has it.
    """
    if offset is not None:
        found = (start[0] + offset[0], start[1] + offset[1])
        r0, r1 = math.dist(start, found), math.dist(end, found)
        return found if r0 > 0.0 and abs(r0 - r1) <= RADIUS_MISMATCH else None
    half = math.dist(start, end) / 2.0
    if radius is None or half == 0.0 or half > abs(radius) * (1.0 + 1e-6):
        return None
    height = math.sqrt(max(radius * radius - half * half, 0.0)) / (2.0 * half)
    if (radius < 0.0) == ccw:
        height = -height
    dx, dy = end[0] - start[0], end[1] - start[1]
    return (start[0] + dx / 2.0 - height * dy, start[1] + dy / 2.0 + height * dx)


def chords(start: Point, end: Point, centre: Point, ccw: bool) -> Array:
    """Points after ``start`` on the arc, the last one ``end``, (k, 2).

    Chords stay within TOLERANCE of the arc. Equal start and end make a full circle.
    """
    from pygcode import GCodeArcMoveCCW, GCodeArcMoveCW
    from pygcode.machine import Position
    from pygcode.transform import ArcLinearizeInside, linearize_arc

    if start == end:  # pygcode has no full circles
        far = (2.0 * centre[0] - start[0], 2.0 * centre[1] - start[1])
        return np.vstack([chords(start, far, centre, ccw), chords(far, end, centre, ccw)])
    kind = GCodeArcMoveCCW if ccw else GCodeArcMoveCW
    arc = kind(X=end[0], Y=end[1], I=centre[0] - start[0], J=centre[1] - start[1])
    lines = linearize_arc(
        arc,
        Position(X=start[0], Y=start[1], Z=0.0),
        method_class=ArcLinearizeInside,
        max_error=TOLERANCE,
    )
    points = np.array([(line.X, line.Y) for line in lines], dtype=float)
    points[-1] = end
    return points
