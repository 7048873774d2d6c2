"""Profiles and samples of a plan.

A profile has seven phases of constant jerk for each of r runs: durations t and jerks j, (r, 7).
"""

from __future__ import annotations

import math

import numpy as np

from hframe_post.arrays import TS, Array, Flags, Integers
from hframe_post.native import kernels

DRIFT = 1e-6  # mm by which a profile may miss its run's end through rounding
FORGIVEN = 1e-9  # of a sample, by which a time may be after it


def samples_until(seconds: float) -> int:
    """Return the first whole sample at or after a time, forgiving a billionth of a sample."""
    return math.ceil(seconds / TS - FORGIVEN)


def ramps(v0: Array, v1: Array, length: Array, jerk: float) -> tuple[Array, Array, Array]:
    """Return one change of speed along the whole of each length, with the least acceleration.

    All (r,). Returns durations and jerks of the seven phases, (r, 7), and the acceleration
    (r,): the root of a²/j − T·a + |v1 − v0| = 0 with T = 2·length/(v0 + v1).
    """
    (t, j), a = np.empty((2, len(v0), 7)), np.empty(len(v0))
    kernels.ramps(v0, v1, length, len(v0), jerk, t, j, a)
    return t, j, a


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
