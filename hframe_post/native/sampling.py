"""Profiles and samples of a plan, in C and in numpy.

A profile has seven phases of constant jerk for each of r runs: durations t and jerks j, (r, 7).
"""

from __future__ import annotations

import math

import numpy as np

from hframe_post.arrays import TS, Array, Flags, Integers, Z
from hframe_post.native import kernel

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
    if (compiled := kernel("ramps")) is not None:
        (t, j), a = np.empty((2, len(v0), 7)), np.empty(len(v0))
        compiled(v0, v1, length, len(v0), jerk, t, j, a)
        return t, j, a
    change = v1 - v0
    with np.errstate(divide="ignore", invalid="ignore"):
        T = 2.0 * length / (v0 + v1)
        root = np.sqrt(np.maximum(T * T - 4.0 * np.abs(change) / jerk, 0.0))
        a = 2.0 * np.abs(change) / (T + root)
        ramp = a / jerk
        t = np.zeros((len(v0), 7))
        t[:, 0] = t[:, 2] = ramp
        t[:, 1] = np.where(np.isfinite(T), T - 2.0 * ramp, 0.0)
    j = np.zeros((len(v0), 7))
    j[:, 0] = np.copysign(jerk, change)
    j[:, 2] = -j[:, 0]
    return t, j, a


def misses(t: Array, j: Array, v0: Array, length: Array) -> Flags:
    """Return which runs have a profile that goes backwards or misses their length, (r,)."""
    if (compiled := kernel("misses")) is not None:
        missed = np.empty(len(t), bool)
        compiled(t, j, v0, length, len(t), DRIFT, missed)
        return missed
    _, v, steps = integrate(t, j, v0)
    missed = np.abs(np.cumsum(steps, axis=1)[:, -1] - length) > DRIFT
    return np.asarray(missed | (v.min(axis=1) < -DRIFT))


def phases(t: Array, j: Array, speed: Array, s: Array, start: float) -> tuple[Array, float]:
    """Return the phases of runs that begin at time ``start``, s, and the time of their end.

    speed, s (r + 1,): speed and path length at the ends of runs. The phases (6, p): start time,
    duration, and path length, speed, acceleration, jerk at the start. Points of rest are put on
    whole samples.
    """
    if (compiled := kernel("phases")) is not None:
        room, last = np.empty(6 * t.size), np.empty(1)
        p = compiled(t, j, speed, s, len(t), start, TS, FORGIVEN, room, last)
        return room[: 6 * p].reshape(6, p), float(last[0])
    a, v, steps = integrate(t, j, speed[:-1])
    end = start + np.cumsum(np.cumsum(t, axis=1)[:, -1])
    wait = np.zeros(len(end))  # rest after runs so far, to whole samples
    for run in np.flatnonzero(speed[1:] == 0.0):  # few: corners without speed
        arrival = end[run] + wait[run]
        wait[run:] += max(samples_until(arrival) - arrival / TS, 0.0) * TS
    begin = np.concatenate([[start], end + wait])
    place = s[:-1, None] + _exclusive(np.cumsum(steps, axis=1))
    time = begin[:-1, None] + _exclusive(np.cumsum(t, axis=1))
    keep = t.ravel() > 0.0
    table = np.stack([column.ravel()[keep] for column in (time, t, place, v, a, j)])
    return table, float(begin[-1])


def integrate(t: Array, j: Array, v0: Array) -> tuple[Array, Array, Array]:
    """Return acceleration and speed at the start of each phase, and its path length; all (r, 7)."""
    da = j * t
    a = _exclusive(np.cumsum(da, axis=1))
    v = v0[:, None] + _exclusive(np.cumsum(t * (a + da / 2.0), axis=1))
    return a, v, t * (v + t * (a / 2.0 + da / 6.0))


def _exclusive(cumulative: Array) -> Array:
    """Return cumulative sums along the rows as they are before each term."""
    shifted = np.zeros_like(cumulative)
    shifted[:, 1:] = cumulative[:, :-1]
    return shifted


def path_lengths(table: Array, first: int, n: int, end: float) -> Array:
    """Return the path length (n,) at samples first, first + 1, …, within 0 … ``end``.

    table (6, p): see ``phases``. Between two phases the path rests where the earlier one ended.
    """
    if (compiled := kernel("path_lengths")) is not None:
        s = np.empty(n)
        compiled(table, table.shape[1], first, n, TS, end, s)
        return s
    t = TS * np.arange(first, first + n).astype(float)
    time, duration, *_ = table
    phase = np.clip(np.searchsorted(time, t, side="right") - 1, 0, None)
    _, _, s, v, a, j = table[:, phase]
    dt = np.minimum(t - time[phase], duration[phase])
    length = s + dt * (v + dt * (a / 2.0 + dt * j / 6.0))
    return np.asarray(np.clip(length, 0.0, end))


def follow(lengths: Array, points: Array, s: Array) -> tuple[Array, Integers]:
    """Return x, y, z, e at path lengths ``s`` (n,), and the move that each lies on.

    lengths (m + 1,): path length at the vertices points (m + 1, 4) of m moves.
    """
    n, moves = len(s), len(lengths) - 1
    if (compiled := kernel("follow")) is not None:
        xyze, move = np.empty((n, 4)), np.empty(n, dtype=np.int64)
        compiled(lengths, np.ascontiguousarray(points), moves, s, n, xyze, move)
        return xyze, move
    move = np.clip(np.searchsorted(lengths, s, side="right") - 1, 0, moves - 1)
    start = points[move]
    share = (s - lengths[move]) / (lengths[move + 1] - lengths[move])
    return start + share[:, None] * (points[move + 1] - start), move


def move_at_rest(way: Array, ends: Array, first: int, n: int, samples: int) -> Array:
    """Return x, y, z, e (n, 4) after ``first``, first + 1, … samples of a move in z and e.

    way: see ``distance``; ends (2, 4): where it begins and ends; samples: when it is done.
    """
    if (compiled := kernel("move_at_rest")) is not None:
        xyze = np.empty((n, 4))
        compiled(way, ends, first, n, samples, TS, xyze)
        return xyze
    at = np.arange(first, first + n)
    done = distance(way, at.astype(float) * TS) / way[0]
    share = np.where(at < samples, done, 1.0)[:, None]
    start, end = ends[:, Z:]
    return np.hstack([np.tile(ends[1, :Z], (n, 1)), start + share * (end - start)])


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
