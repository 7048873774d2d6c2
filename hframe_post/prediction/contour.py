"""Contour error: the distance of the nozzle to the path, not to where it should be at that time."""

from __future__ import annotations

import numpy as np

from hframe_post.arrays import Array, Flags, Integers, X, Y
from hframe_post.model.stop_cost import NEAREST
from hframe_post.native import kernel

COARSE = 3  # samples from one candidate to the next in the first search
STRAIGHT = 1e-6  # sine of an angle below which a path goes straight on


def contour_error(path: Array, actual: Array, at: Integers) -> Array:
    """Return the distance (n,) of the points ``actual`` (n, 2), at equal time steps, to the path.

    path (p, 2): the desired samples; at (n,): which of them belongs to each point. The path
    is the polyline through its samples within NEAREST of that. Where this is a straight line,
    the distance is that to the line; elsewhere the nearest sample is found first, then the
    nearer of the two segments that meet there.
    """
    px, py = np.ascontiguousarray(path[:, X]), np.ascontiguousarray(path[:, Y])
    ax, ay = np.ascontiguousarray(actual[:, X]), np.ascontiguousarray(actual[:, Y])
    if (compiled := kernel("contour_error")) is None:
        return _contour_error(px, py, ax, ay, at)
    n, p = len(ax), len(px)
    error = np.empty(n)
    compiled(px, py, p, ax, ay, at, n, NEAREST, COARSE, STRAIGHT, error, np.empty(p + 1, np.int64))
    return error


def _contour_error(px: Array, py: Array, ax: Array, ay: Array, at: Integers) -> Array:
    low, high = np.maximum(at - NEAREST, 0), np.minimum(at + NEAREST, len(px) - 1)
    turns = np.concatenate([[0], np.cumsum(_turns(px, py))])
    error = _to_segment(ax, ay, px[low], py[low], px[high], py[high])
    bent = np.flatnonzero(turns[high] != turns[low + 1])  # a turn strictly between
    ax, ay, at = ax[bent], ay[bent], at[bent]
    coarse = _nearest(px, py, ax, ay, [at + k for k in range(-NEAREST, NEAREST + 1, COARSE)])
    # next what was left out: around the result, and around the sample of the same time, which is
    # right at sharp corners if the nozzle follows well
    k = _nearest(px, py, ax, ay, [coarse - 1, coarse, coarse + 1, at - 1, at, at + 1])
    k = np.clip(k, 0, len(px) - 1)
    before, after = np.maximum(k - 1, 0), np.minimum(k + 1, len(px) - 1)
    x, y = px[k], py[k]
    error[bent] = np.minimum(
        _to_segment(ax, ay, x, y, px[before], py[before]),
        _to_segment(ax, ay, x, y, px[after], py[after]),
    )
    return np.sqrt(error)


def _turns(px: Array, py: Array) -> Flags:
    """Return at which of its p samples the path changes its direction."""
    dx, dy = np.diff(px), np.diff(py)
    cross, dot = dx[:-1] * dy[1:] - dy[:-1] * dx[1:], dx[:-1] * dx[1:] + dy[:-1] * dy[1:]
    still = (dx == 0.0) & (dy == 0.0)
    turning = (np.abs(cross) > STRAIGHT * np.abs(dot)) | (dot < 0.0)
    turns = np.ones(len(px), dtype=bool)
    turns[1:-1] = turning | (still[:-1] != still[1:])
    return turns


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


def _to_segment(ax: Array, ay: Array, px: Array, py: Array, qx: Array, qy: Array) -> Array:
    """Return the squared distance (q,) of points a to the segments from p to q, all (q,)."""
    dx, dy, ax, ay = qx - px, qy - py, ax - px, ay - py
    length2 = dx * dx + dy * dy
    share = np.divide(ax * dx + ay * dy, length2, out=np.zeros(len(ax)), where=length2 > 0.0)
    np.minimum(np.maximum(share, 0.0, out=share), 1.0, out=share)
    dx *= share
    dy *= share
    ax -= dx
    ay -= dy
    return ax * ax + ay * ay
