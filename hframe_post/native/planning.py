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

from hframe_post.arrays import TS, Array, Flags, Integers
from hframe_post.native import kernels


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

PLATEAU = 256  # moves at cruise speed in a run
# Shares of acceleration and jerk, and of the cruise speed at vertices, that keep Ruckig off the
# edge of what is feasible
FEASIBLE, BELOW_CRUISE = 1.0 - 1e-6, 1.0 - 1e-4
STEEP = 1.0  # rise over run above which a move starts and ends at rest
CREEP = 0.01  # mm/s; a junction that allows less is a stop

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


def limit_moves(
    points: Array, speed: Array, acceleration: Array, corner: Array, rules: Array
) -> Array:
    """Return the table (n, 5) of moves between points (n + 1, 4) with limits.

    speed, acceleration, corner (n,): what the file asks for. rules (21,): cruise speed,
    acceleration, speed in z, of retractions, of melted filament, acceleration in z, of filament,
    speed through a square corner, junction deviation; then speed and acceleration of motors A and
    B, z and e, and the matrix from x, y to A and B.
    """
    table = np.empty((len(speed), 5))
    kernels.limit_moves(points, speed, acceleration, corner, len(table), rules, table)
    return table


def lower_moves(points: Array, limits: Array, speed: Array, acceleration: Array) -> int:
    """Lower speed and acceleration (n,) of moves between points (n + 1, 4); return how many were.

    limits (13,): speed and acceleration of motors A and B, z and e, the matrix from x, y to A and
    B, and speed along the path.
    """
    lowered: int = kernels.lower_moves(points, len(speed), limits, speed, acceleration)
    return lowered


def greatest_speeds(
    points: Array, moves: Array, rules: Array, extruder_corner_velocity: float,
    shorter: float = math.inf, steep: float = STEEP,
) -> Array:  # fmt: skip
    """Return the greatest speed at each vertex, (n + 1,), without limits at the ends.

    rules: see ``limit_moves``. shorter: mm; arcs must fit into shorter moves on a board with
    junction deviation; inf: it has none. steep: rise over run above which a move is made from rest.
    """
    caps = np.empty(len(points))
    constants = rules, extruder_corner_velocity, shorter, BELOW_CRUISE, steep, CREEP
    kernels.junctions(points, moves, len(moves), *constants, caps)
    return caps


def find_runs(moves: Array, caps: Array, jerk: float, last: float) -> Runs:
    """Return the path length at each vertex, which vertices end runs, and the speeds there.

    caps (n + 1,): greatest speeds at the vertices; last: speed at the last vertex, mm/s. A move at
    which the machine rests is a run; after it, lengths begin again at 0.
    """
    n = len(moves)
    (s, speed), ends = np.empty((2, n + 1)), np.empty(n + 1, np.int64)
    constants = FEASIBLE * jerk, last, FEASIBLE, PLATEAU
    r = kernels.find_runs(moves, caps, n, *constants, np.empty(6 * (n + 1)), s, ends, speed)
    return s, ends[: r + 1], speed[: r + 1]


def smoothed_runs(
    s: Array, ends: Integers, speed: Array, cruise: Array, most: Array, ratios: Array
) -> tuple[Array, Array, Array]:
    """Return speeds at the ends of runs, (r + 1,), top speeds and seconds (r,), as Klipper's.

    s: path length at the vertices; ends, speed (r + 1,): see ``find_runs``; cruise, most (r,):
    greatest speed and acceleration; ratios (r,): see ``FileLimits.cruise_ratio``. Runs in which s
    begins again take no time.
    """
    r = len(cruise)
    speed, top, seconds = speed.copy(), np.empty(r), np.empty(r)
    room = np.empty(4 * (r + 1))
    n = len(s)
    kernels.smoothed_runs(s, n, ends, cruise, most, ratios, r, room, speed, top, seconds)
    return speed, top, seconds


# ----------------------------------------------------------------------
# Profiles and samples of a plan.
#
# A profile has seven phases of constant jerk for each of r runs: durations t and jerks j, (r, 7).

DRIFT = 1e-6  # mm by which a profile may miss its run's end through rounding
ALMOST = 0.999  # share of a limit that counts as all of it
FORGIVEN = 1e-9  # of a sample, by which a time may be after it


def samples_until(seconds: float) -> int:
    """Return the first whole sample at or after a time, forgiving a billionth of a sample."""
    return math.ceil(seconds / TS - FORGIVEN)


def profiles(
    v0: Array, v1: Array, length: Array, cruise: Array, most: Array, jerk: float
) -> tuple[Array, Array, Integers]:
    """Return durations and jerks of the fastest runs, (r, 7), and which have no closed form.

    All (r,): speeds at both ends, length, greatest speed and acceleration. Those without a closed
    form are filled with one change of speed along all of the length, with the least acceleration.
    """
    (t, j), r = np.empty((2, len(v0), 7)), len(v0)
    others = np.empty(r, np.int64)
    limits = v0, v1, length, cruise, most, r, jerk, ALMOST
    return t, j, others[: kernels.profiles(*limits, t, j, others)]


def misses(t: Array, j: Array, v0: Array, length: Array) -> Flags:
    """Return which runs have a profile that goes backwards or misses their length, (r,)."""
    missed = np.empty(len(t), bool)
    kernels.misses(t, j, v0, length, len(t), DRIFT, missed)
    return missed


def phases(t: Array, j: Array, speed: Array, s: Array, start: float) -> tuple[Array, float]:
    """Return the phases of runs that begin at time ``start``, s, and the time of their end.

    speed, s (r + 1,): speed and path length at the ends of runs. The phases (6, p): start time,
    duration, and path length, speed, acceleration, jerk at the start. Points of rest are put on
    whole samples.
    """
    room, last = np.empty(6 * t.size), np.empty(1)
    p = kernels.phases(t, j, speed, s, len(t), start, TS, FORGIVEN, room, last)
    return room[: 6 * p].reshape(6, p), float(last[0])


def path_lengths(table: Array, first: int, n: int, end: float) -> Array:
    """Return the path length (n,) at samples first, first + 1, …, within 0 … ``end``.

    table (6, p): see ``phases``. Between two phases the path rests where the earlier one ended.
    """
    s = np.empty(n)
    kernels.path_lengths(table, table.shape[1], first, n, TS, end, s)
    return s


def follow(lengths: Array, points: Array, s: Array) -> tuple[Array, Integers]:
    """Return x, y, z, e at path lengths ``s`` (n,), and the move that each lies on.

    lengths (m + 1,): path length at the vertices points (m + 1, 4) of m moves.
    """
    n, moves = len(s), len(lengths) - 1
    xyze, move = np.empty((n, 4)), np.empty(n, dtype=np.int64)
    kernels.follow(lengths, np.ascontiguousarray(points), moves, s, n, xyze, move)
    return xyze, move


def move_at_rest(way: Array, ends: Array, first: int, n: int, samples: int) -> Array:
    """Return x, y, z, e (n, 4) after ``first``, first + 1, … samples of a move in z and e.

    way: see ``distance``; ends (2, 4): where it begins and ends; samples: when it is done.
    """
    xyze = np.empty((n, 4))
    kernels.move_at_rest(way, ends, first, n, samples, TS, xyze)
    return xyze


def distance(way: Array, t: Array) -> Array:
    """Return the distance done (n,), mm, at times t (n,), s, after the start of a trapezoid.

    way (7,): its length, speed at the start, acceleration, peak speed, how long it speeds up and
    how long it slows down, and its seconds in all.
    """
    _, v_s, a, peak, up, down, seconds = way.tolist()
    t = np.clip(t, 0.0, seconds)
    begun, ending = np.minimum(t, up), np.maximum(t - (seconds - down), 0.0)
    lost = a * ending * ending / 2.0
    return np.asarray(begun * (v_s + a * begun / 2.0) + peak * (t - begun) - lost)
