"""The way from a path to the nozzle, in C and in numpy."""

from __future__ import annotations

import numpy as np

from hframe_post.arrays import Array, Flags, Integers, X, Y, Z
from hframe_post.native import kernel

COARSE = 3  # samples from one candidate to the next in the first search
STRAIGHT = 1e-6  # sine of an angle below which a path goes straight on


def count_turns(path: Array) -> Integers:
    """Return how many samples of a path (p, ≥2) before each change its direction, (p + 1,)."""
    turns = np.zeros(len(path) + 1, np.int64)
    if (compiled := kernel("count_turns")) is not None:
        compiled(path, path.shape[1], len(path), STRAIGHT, turns)
        return turns
    dx, dy = np.diff(path[:, X]), np.diff(path[:, Y])
    cross, dot = dx[:-1] * dy[1:] - dy[:-1] * dx[1:], dx[:-1] * dx[1:] + dy[:-1] * dy[1:]
    still = (dx == 0.0) & (dy == 0.0)
    turning = (np.abs(cross) > STRAIGHT * np.abs(dot)) | (dot < 0.0)
    changes = np.ones(len(path), dtype=bool)
    changes[1:-1] = turning | (still[:-1] != still[1:])
    np.cumsum(changes, out=turns[1:])
    return turns


def deviation(
    path: Array, turns: Integers, nozzle: Array, first: int, at: Integers, reach: int
) -> Array:
    """Return the shortest way (k, 2) from a path (p, ≥2) to the nozzle at its samples ``at`` (k,).

    turns: see ``count_turns``; nozzle (n, ≥2): at samples first … first + n − 1. x and y come
    first. The path counts within ``reach`` samples of each. Where it is a straight line, the
    distance is that to the line; elsewhere the nearest sample is found first, then the nearer of
    the two segments that meet there.
    """
    p = len(path)
    if (compiled := kernel("deviation")) is not None:
        nozzle, off = np.ascontiguousarray(nozzle), np.empty((len(at), 2))
        of_path, of_nozzle = (path, path.shape[1], p, turns), (nozzle, nozzle.shape[1], len(nozzle))
        compiled(*of_path, *of_nozzle, first, at, len(at), reach, COARSE, off)
        return off
    px, py = path[:, X], path[:, Y]
    ax, ay = nozzle[at - first, :Z].T
    low, high = np.maximum(at - reach, 0), np.minimum(at + reach, p - 1)
    off = _from_segment(ax, ay, px[low], py[low], px[high], py[high])
    bent = np.flatnonzero(turns[high] != turns[low + 1])  # a turn strictly between
    ax, ay, at = ax[bent], ay[bent], at[bent]
    coarse = _nearest(px, py, ax, ay, [at + k for k in range(-reach, reach + 1, COARSE)])
    # next what was left out: around the result, and around the sample of the same time, which
    # is right at sharp corners if the nozzle follows well
    k = _nearest(px, py, ax, ay, [coarse - 1, coarse, coarse + 1, at - 1, at, at + 1])
    k = np.clip(k, 0, p - 1)
    before, after = np.maximum(k - 1, 0), np.minimum(k + 1, p - 1)
    x, y = px[k], py[k]
    one = _from_segment(ax, ay, x, y, px[before], py[before])
    other = _from_segment(ax, ay, x, y, px[after], py[after])
    nearer = square(one) < square(other)
    off[bent] = np.where(nearer[:, None], one, other)
    return off


def _nearest(px: Array, py: Array, ax: Array, ay: Array, candidates: list[Integers]) -> Integers:
    """Return which of the candidate samples, (q,) each, is nearest to each of the points a (q,)."""
    nearest, best = candidates[0], np.full(len(ax), np.inf)
    for candidate in candidates:
        k = np.clip(candidate, 0, len(px) - 1)
        dx, dy = px[k] - ax, py[k] - ay
        distance2 = dx * dx + dy * dy
        nearest = np.where(distance2 < best, candidate, nearest)
        np.minimum(best, distance2, out=best)
    return nearest


def square(off: Array) -> Array:
    """Return the squares (q,) of lengths of ways (q, 2)."""
    return np.asarray(off[:, X] * off[:, X] + off[:, Y] * off[:, Y])


def _from_segment(ax: Array, ay: Array, px: Array, py: Array, qx: Array, qy: Array) -> Array:
    """Return the shortest way (q, 2) to points a from the segments between p and q, all (q,)."""
    dx, dy, ax, ay = qx - px, qy - py, ax - px, ay - py
    length2 = dx * dx + dy * dy
    share = np.divide(ax * dx + ay * dy, length2, out=np.zeros(len(ax)), where=length2 > 0.0)
    np.minimum(np.maximum(share, 0.0, out=share), 1.0, out=share)
    dx *= share
    dy *= share
    ax -= dx
    ay -= dy
    return np.column_stack([ax, ay])


def moving(xyze: Array, first: int, every: int) -> tuple[Integers, Flags]:
    """Return which of every n-th sample from ``first`` on move, and which of them extrude, (k,)."""
    if (compiled := kernel("moving")) is not None:
        at, extruding = np.empty(len(xyze), np.int64), np.empty(len(xyze), bool)
        count = compiled(xyze, len(xyze), first, every, at, extruding)
        return at[:count], extruding[:count]
    at = np.arange(first, len(xyze), every)
    moves, extruding = (flags[at] for flags in in_motion(xyze))
    return at[moves], extruding[moves]


def in_motion(xyze: Array) -> tuple[Flags, Flags]:
    """Return at which samples the path xyze (n, 4) moves, and at which it extrudes too, (n,)."""
    moves, extruding = np.zeros((2, len(xyze)), dtype=bool)
    x, y, _, e = xyze.T
    moves[1:] = (x[1:] != x[:-1]) | (y[1:] != y[:-1])
    extruding[1:] = moves[1:] & (e[1:] > e[:-1])
    return moves, extruding
