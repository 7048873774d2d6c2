"""Look-ahead over a queue of moves: limits, junctions, and speeds of runs.

Moves are a table (n, 4): length, cruise speed, acceleration and junction deviation of each. See
``planner.lookahead`` for the rules.
"""

from __future__ import annotations

import math

import numpy as np

from hframe_post.arrays import Array, Integers
from hframe_post.native import kernels

PLATEAU = 256  # moves at cruise speed in a run
# Shares of acceleration and jerk, and of the cruise speed at vertices, that keep Ruckig off the
# edge of what is feasible
FEASIBLE, BELOW_CRUISE = 1.0 - 1e-6, 1.0 - 1e-4
STEEP = 1.0  # rise over run above which a move starts and ends at rest
CREEP = 0.01  # mm/s; a junction that allows less is a stop

Runs = tuple[Array, Integers, Array]


def limit_moves(
    points: Array, speed: Array, acceleration: Array, corner: Array, rules: Array
) -> Array:
    """Return the table (n, 4) of moves between points (n + 1, 4) with limits.

    speed, acceleration, corner (n,): what the file asks for. rules (23,): cruise speed,
    that of travels, acceleration, that of travels, speed in z, of retractions, of melted filament,
    acceleration in z, of filament, speed through a square corner, junction deviation; then speed
    and acceleration of motors A and B, z and e, and the matrix from x, y to A and B.
    """
    table = np.empty((len(speed), 4))
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
    points: Array, moves: Array, extruder_corner_velocity: float, shorter: float = math.inf,
    steep: float = STEEP,
) -> Array:  # fmt: skip
    """Return the greatest speed at each vertex, (n + 1,), without limits at the ends.

    shorter: see ``junction_speeds``. steep: rise over run above which a move is made from rest.
    """
    caps = np.empty(len(points))
    constants = extruder_corner_velocity, shorter, BELOW_CRUISE, steep, CREEP
    kernels.junctions(points, moves, len(moves), *constants, caps)
    return caps


def find_runs(moves: Array, caps: Array, jerk: float, deceleration: float, last: float) -> Runs:
    """Return the path length at each vertex, which vertices end runs, and the speeds there.

    caps (n + 1,): greatest speeds at the vertices; last: speed at the last vertex, mm/s.
    """
    n = len(moves)
    (s, speed), ends = np.empty((2, n + 1)), np.empty(n + 1, np.int64)
    constants = FEASIBLE * jerk, deceleration, last, FEASIBLE, PLATEAU
    r = kernels.find_runs(moves, caps, n, *constants, np.empty(8 * (n + 1)), s, ends, speed)
    return s, ends[: r + 1], speed[: r + 1]


def run_seconds(s: Array, ends: Integers, speed: Array, cruise: Array, most: Array) -> Array:
    """Return how long runs take if nothing limits their jerk, (r,).

    s: path length at the vertices; ends, speed (r + 1,): see ``find_runs``; cruise, most (r,):
    greatest speed and acceleration.
    """
    seconds = np.empty(len(cruise))
    kernels.run_seconds(s, len(s), ends, speed, cruise, most, len(cruise), seconds)
    return seconds


def smoothed_runs(
    s: Array, ends: Integers, speed: Array, cruise: Array, most: Array, ratios: Array
) -> tuple[Array, Array, Array]:
    """Return speeds at the ends of runs, (r + 1,), top speeds and seconds (r,), as Klipper's.

    ratios (r,): see ``FileLimits.cruise_ratio``. See ``run_seconds`` for the others.
    """
    r = len(cruise)
    speed, top, seconds = speed.copy(), np.empty(r), np.empty(r)
    room = np.empty(4 * (r + 1))
    n = len(s)
    kernels.smoothed_runs(s, n, ends, cruise, most, ratios, r, room, speed, top, seconds)
    return speed, top, seconds
