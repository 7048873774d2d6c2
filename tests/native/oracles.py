"""Loops in numpy that the tests compare compiled ones with, or use as they are."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hframe_post.arrays import Array, E, Flags, Integers, Z, lengths
from hframe_post.native.planning import junction_speeds
from hframe_post.native.ramps import LATE, MADE_UP, ends, speeds, whole_feeds


def reachable_speed(v0: Array, length: Array, acceleration: Array, jerk: float) -> Array:
    """Return the greatest speed reached from ``v0`` within ``length``, all (n,), mm and s.

    It starts and ends at zero acceleration. Accelerating by Δ takes T = Δ/a + a/j, or 2√(Δ/j)
    where Δ < a²/j, over (v0 + Δ/2)·T.
    """
    a, j = acceleration, jerk
    # full acceleration: Δ²/2a + Δ(v0/a + a/2j) + v0·a/j − length = 0
    b = v0 / a + a / (2.0 * j)
    c = length - v0 * a / j
    full = a * (np.sqrt(np.maximum(b * b + 2.0 * c / a, 0.0)) - b)
    # never at full acceleration: u³ + 2·v0·u − length·√j = 0 with u = √Δ
    q = length * math.sqrt(j)
    p = np.maximum(2.0 * v0, 1e-12)
    fourth = np.sqrt(np.sqrt(q))
    sixteenth = np.sqrt(np.sqrt(fourth))
    u = np.minimum(fourth * sixteenth * np.sqrt(np.sqrt(sixteenth)), q / p)  # within a half
    for _ in range(5):  # Newton's steps to the last digit, since libraries' cube roots differ
        u = (2.0 * u * u * u + q) / (3.0 * u * u + p)
    return v0 + np.where(full >= a * a / j, full, np.minimum(u * u, a * a / j))


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


@dataclass(frozen=True, slots=True)
class Ramped:
    """Segments with Klipper's ramps: length, acceleration and greatest speed of each (k,).

    caps (k + 1,): greatest speeds at their ends.
    """

    d: Array
    a: Array
    top: Array
    caps: Array

    @classmethod
    def from_moves(
        cls, delta: Array, rest: Flags, limits: Array, after: float = math.inf
    ) -> Ramped:
        """Return the segments of moves delta (k, 4) in x, y, z, e.

        z and retraction lower acceleration and speed. rest (k + 1,): whether Klipper rests at
        each end; limits (8,): see ``klipper_feeds``; after: greatest speed at the last.
        """
        velocity, acceleration, z_velocity, z_acceleration, *of_e = limits.tolist()
        e_velocity, e_acceleration, e_corner, deviation = of_e
        d = lengths(delta[:, :E])
        with np.errstate(divide="ignore"):
            per_z = d / np.abs(delta[:, Z])
            per_e = np.where(delta[:, E] < 0.0, d / np.abs(delta[:, E]), math.inf)
        a = np.minimum(per_z * z_acceleration, per_e * e_acceleration)
        top = np.minimum(per_z * z_velocity, per_e * e_velocity)
        a, top = np.minimum(a, acceleration), np.minimum(top, velocity)
        inner = junction_speeds(delta, d, a, deviation, e_corner)
        corners = np.concatenate([[math.inf], inner, [after]])
        return cls(d, a, top, np.where(rest, 0.0, corners))

    def speeds(self, T: Array, before: float) -> Array:
        """Return the cruise speeds (k,) for the times T (k,); before: of the segment before."""
        return speeds(self.d, T, self.a, self.caps, before)

    def durations(self, v: Array, before: float) -> Array:
        """Return the seconds (k,), with no speed that the accelerations do not reach."""
        d, a, top = self.d, self.a, np.minimum(v, self.top)
        v_s, v_e = ends(top, self.caps, before)
        joint = np.append(v_s, v_e[-1:])
        for i in range(len(d)):
            joint[i + 1] = min(joint[i + 1], np.sqrt(joint[i] * joint[i] + 2.0 * a[i] * d[i]))
        for i in reversed(range(len(d))):
            most = joint[i + 1] * joint[i + 1] + 2.0 * a[i] * d[i]
            joint[i] = min(joint[i], np.sqrt(most))
        v_s, v_e = joint[:-1], joint[1:]
        peak = np.minimum(top, np.sqrt((v_s * v_s + v_e * v_e) / 2.0 + a * d))
        up, down = peak - v_s, peak - v_e
        return np.asarray((d + (up * up + down * down) / (2.0 * a)) / peak)


def _made_up(T: Array, late: Array) -> Array:
    """Return T (k,), shortened after segments that are late by (k,) s at any feed rate.

    Lateness waits in a queue, from which each segment in time takes a share of its T.
    """
    taken = np.where(late > 0.0, 0.0, MADE_UP * T)
    total = np.cumsum(late - taken)
    waiting = total - np.minimum(np.minimum.accumulate(total), 0.0)
    return np.asarray(T - (np.append(0.0, waiting[:-1]) + late - waiting))


def in_motion(xyze: Array) -> tuple[Flags, Flags]:
    """Return at which samples the path xyze (n, 4) moves, and at which it extrudes too, (n,)."""
    moves, extruding = np.zeros((2, len(xyze)), dtype=bool)
    x, y, _, e = xyze.T
    moves[1:] = (x[1:] != x[:-1]) | (y[1:] != y[:-1])
    extruding[1:] = moves[1:] & (e[1:] > e[:-1])
    return moves, extruding


def klipper_feeds(
    at: Array, T: Array, rest: Flags, before: float, after: float, limits: Array, per_feed: float
) -> tuple[Integers, Array]:
    """Return what ``native.ramps.klipper_feeds`` does."""
    ramped = Ramped.from_moves(np.diff(at, axis=0), rest, limits, after)
    v = ramped.speeds(T, before)
    late = ramped.durations(v, before) - T
    if late.max() > LATE:
        v = ramped.speeds(_made_up(T, np.where(late > LATE, late, 0.0)), before)
    F = whole_feeds(v, per_feed)
    return F, ramped.durations(F / per_feed, before)
