"""Speeds at junctions, the look-ahead, and phases of constant jerk.

Junctions: the greatest speeds at which firmware passes the junction of two moves.

They are those of Klipper's ``toolhead`` (docs/Kinematics.md, "Look-ahead"), after Grbl's junction
deviation: the corner is passed as if on an arc that is tangent to both moves and misses their
vertex by the junction deviation. With θ the angle between the moves (180° is straight on),
R = sin(θ/2)/(1 − sin(θ/2)):

    v² ≤ R·deviation·a                  centripetal acceleration on the arc
    v² ≤ ½·length·a·tan(θ/2)            the arc must fit into half of each move
    v ≤ corner velocity / |Δ(e per mm)| sudden change of extrusion speed

A square corner (θ = 90°) is passed at v_sc where deviation = (√2 − 1)·v_sc²/a. These rules are
in ``planning.c`` and ``ramps.c``.

A board with junction deviation has the first of these rules, with differences. Directions are those
of all motors, also of z and filament: it passes from motion into a retraction at a speed. Along the
change of direction no motor exceeds its acceleration. Arcs must fit into moves shorter than 1 mm,
where the path turns by less than 45°.
"""

from __future__ import annotations

import math
from enum import IntEnum

import numpy as np

from hframe_post.arrays import Array, Flags, Integers
from hframe_post.native import compiled


def junction_deviation(square_corner_velocity: Array | float, acceleration: Array | float) -> Array:
    """Return the junction deviation, mm, for a speed through a right angle; same shapes."""
    squared = np.square(square_corner_velocity)
    return np.asarray((math.sqrt(2.0) - 1.0) * squared / acceleration)


def square_corner_velocity(deviation: float, acceleration: float) -> float:
    """Return the speed through a right angle, mm/s, for a junction deviation in mm."""
    return math.sqrt(deviation * acceleration / (math.sqrt(2.0) - 1.0))


# ----------------------------------------------------------------------
# Look-ahead over a queue of moves: limits, junctions, and speeds of runs.
#
# Moves are a table (n, 5). See ``planner.lookahead`` for the rules.

Runs = tuple[Array, Integers, Array]


class Column(IntEnum):
    """Columns of a table of moves.

    DEVIATION: of its junctions. ALONE: whether x and y rest, 1, and the machine before and after
    it, 2.
    """

    LENGTH = 0
    CRUISE = 1
    ACCELERATION = 2
    DEVIATION = 3
    ALONE = 4


@compiled
def limit_moves(
    points: Array, speed: Array, acceleration: Array, corner: Array, rules: Array, /
) -> Array:
    """Return the table (n, 5) of moves between points (n + 1, 4) with limits.

    speed, acceleration, corner (n,): what the file asks for. rules (21,): cruise speed,
    acceleration, speed in z, of retractions, of melted filament, acceleration in z, of filament,
    speed through a square corner, junction deviation; then speed and acceleration of motors A and
    B, z and e, and the matrix from x, y to A and B.
    """


@compiled
def lower_moves(points: Array, limits: Array, speed: Array, acceleration: Array, /) -> int:
    """Lower speed and acceleration (n,) of moves between points (n + 1, 4); return how many were.

    limits (13,): speed and acceleration of motors A and B, z and e, the matrix from x, y to A and
    B, and speed along the path.
    """


@compiled
def greatest_speeds(
    points: Array, moves: Array, rules: Array, extruder_corner_velocity: float, joins: bool,
    steep: float, late: float, /,
) -> tuple[Array, Array]:  # fmt: skip
    """Return the greatest speeds at the vertices, and those that count, (n + 1,) each.

    At the ends nothing but the cruise speed limits them. rules: see ``limit_moves``. joins: whether
    its junctions are those of a board with junction deviation. steep: rise over run above which a
    move is made from rest. late: mm by which the firmware brakes late, so that it reaches corners
    faster than it means to.
    """


@compiled
def find_runs(moves: Array, caps: Array, speed: float, rolling: bool, jerk: float, /) -> Runs:
    """Return the path length at each vertex, which vertices end runs, and the speeds there.

    caps (n,): greatest speeds at which moves begin; the first begins at ``speed``. rolling: the
    last ends at its own speed, instead of in a stop. A move at which the machine rests is a run;
    after it, lengths begin again at 0.
    """


@compiled
def smoothed_runs(
    s: Array, ends: Integers, speed: Array, cruise: Array, most: Array, ratios: Array, /
) -> tuple[Array, Array, Array]:
    """Return speeds at the ends of runs, (r + 1,), top speeds and seconds (r,), as Klipper's.

    s: path length at the vertices; ends, speed (r + 1,): see ``find_runs``; cruise, most (r,):
    greatest speed and acceleration; ratios (r,): see ``FileLimits.cruise_ratio``. Runs in which s
    begins again take no time.
    """


# ----------------------------------------------------------------------
# Profiles and samples of a plan.
#
# A profile has seven phases of constant jerk for each of r runs: durations t and jerks j, (r, 7).


@compiled
def samples_until(seconds: float, /) -> int:
    """Return the first whole sample at or after a time, forgiving a billionth of a sample."""


@compiled
def profiles(
    v0: Array, v1: Array, length: Array, cruise: Array, most: Array, jerk: float, /
) -> tuple[Array, Array, Integers]:
    """Return durations and jerks of the fastest runs, (r, 7), and which have no closed form.

    All (r,): speeds at both ends, length, greatest speed and acceleration. Those without a closed
    form are filled with one change of speed along all of the length, with the least acceleration.
    """


@compiled
def misses(t: Array, j: Array, v0: Array, length: Array, /) -> Flags:
    """Return which runs have a profile that goes backwards or misses their length, (r,)."""


@compiled
def phases(t: Array, j: Array, speed: Array, s: Array, start: float, /) -> tuple[Array, Array]:
    """Return the phases of runs that begin at time ``start``, s, and the time of their end, (1,).

    speed, s (r + 1,): speed and path length at the ends of runs. The phases (6, p): start time,
    duration, and path length, speed, acceleration, jerk at the start. Points of rest are put on
    whole samples.
    """


@compiled
def path_lengths(table: Array, first: int, n: int, end: float, /) -> Array:
    """Return the path length (n,) at samples first, first + 1, …, within 0 … ``end``.

    table (6, p): see ``phases``. Between two phases the path rests where the earlier one ended.
    """


@compiled
def follow(
    lengths: Array, points: Array, line: Integers, s: Array, xyze: Array, line_at: Integers, /
) -> int:
    """Fill in x, y, z, e (n, 4) at path lengths ``s`` (n,), and the line of the move there (n,).

    lengths (m + 1,): path length at the vertices points (m + 1, 4) of m moves; line (m,): theirs.
    """


@compiled
def move_at_rest(way: Array, ends: Array, first: int, samples: int, xyze: Array, /) -> int:
    """Fill in x, y, z, e (n, 4) after ``first``, first + 1, … samples of a move in z and e.

    way: see ``Trapezoid.row``; ends (2, 4): where it begins and ends; samples: when it is done.
    """
