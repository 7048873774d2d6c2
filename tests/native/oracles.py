"""Loops in numpy that the tests compare compiled ones with, or use as they are."""

from __future__ import annotations

import math

import numpy as np

from hframe_post.arrays import Array, Flags


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


def in_motion(xyze: Array) -> tuple[Flags, Flags]:
    """Return at which samples the path xyze (n, 4) moves, and at which it extrudes too, (n,)."""
    moves, extruding = np.zeros((2, len(xyze)), dtype=bool)
    x, y, _, e = xyze.T
    moves[1:] = (x[1:] != x[:-1]) | (y[1:] != y[:-1])
    extruding[1:] = moves[1:] & (e[1:] > e[:-1])
    return moves, extruding
