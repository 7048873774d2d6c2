"""Contour error: the distance of the nozzle to the path, not to where it should be at that time."""

from __future__ import annotations

import numpy as np

from hframe_post.arrays import Array, Flags, Integers, X, Y
from hframe_post.model.stop_cost import NEAREST
from hframe_post.native import kernel

COARSE = 3  # samples from one candidate to the next in the first search
STRAIGHT = 1e-6  # sine of an angle below which a path goes straight on
SEARCHED = 128  # consecutive samples searched together
ROWS_IN_CACHE = 32


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
    n, p = len(ax), len(px)
    if not n:
        return np.zeros(0)
    low, high = np.maximum(at - NEAREST, 0), np.minimum(at + NEAREST, p - 1)
    turns = np.concatenate([[0], np.cumsum(_turns(px, py))])
    straight = turns[high] == turns[low + 1]  # no turn strictly between
    error = _to_segment(ax, ay, px[low], py[low], px[high], py[high])
    rows = np.logical_or.reduceat(~straight, np.arange(0, n, SEARCHED))
    which = np.flatnonzero(np.repeat(rows, SEARCHED)[:n])  # neighbours are searched together
    if len(which):
        ax, ay = ax[which], ay[which]
        every = int(at[1] - at[0]) if n > 1 else 1
        k = _nearest(px, py, ax, ay, at[which], every)
        x, y = px[k], py[k]
        before, after = np.maximum(k - 1, 0), np.minimum(k + 1, p - 1)
        nearer = np.minimum(
            _to_segment(ax, ay, x, y, px[before], py[before]),
            _to_segment(ax, ay, x, y, px[after], py[after]),
        )
        error[which] = np.where(straight[which], error[which], nearer)
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


def _nearest(px: Array, py: Array, ax: Array, ay: Array, at: Integers, every: int) -> Integers:
    """Return the samples within NEAREST of ``at`` (q,) that are nearest to the points a (q,).

    ``at`` consists of rows of SEARCHED samples, ``every`` apart; the last row may be shorter.
    """
    q, span = len(at), SEARCHED * every
    width = span + 2 * NEAREST
    rows = -(-q // SEARCHED)
    window = np.clip(at[::SEARCHED, None] - NEAREST + np.arange(width), 0, len(px) - 1)
    wx, wy = px[window], py[window]
    here = np.zeros((2, rows, SEARCHED))
    here[0].ravel()[:q], here[1].ravel()[:q] = ax, ay
    nearest = np.zeros((rows, SEARCHED), dtype=np.int8)
    for r in range(0, rows, ROWS_IN_CACHE):
        some = slice(r, r + ROWS_IN_CACHE)
        x, y, best = here[0, some], here[1, some], np.full(here[0, some].shape, np.inf)
        dx, dy = np.empty_like(x), np.empty_like(y)
        for shift in range(0, 2 * NEAREST + 1, COARSE):
            np.subtract(x, wx[some, shift : shift + span : every], out=dx)
            np.subtract(y, wy[some, shift : shift + span : every], out=dy)
            np.multiply(dx, dx, out=dx)
            np.multiply(dy, dy, out=dy)
            np.add(dx, dy, out=dx)
            np.copyto(nearest[some], shift, where=dx < best)
            np.minimum(best, dx, out=best)
    coarse = at - NEAREST + nearest.ravel()[:q]
    return _refined(px, py, ax, ay, (coarse - 1, coarse, coarse + 1, at - 1, at, at + 1))


def _refined(
    px: Array, py: Array, ax: Array, ay: Array, candidates: tuple[Integers, ...]
) -> Integers:
    """Return the nearest of the candidate samples (each (q,)) to each point.

    They are those the coarse search left out: around its result, and around the sample of the
    same time, which is right at sharp corners if the nozzle follows well.
    """
    nearest, best = candidates[0], np.full(len(ax), np.inf)
    for candidate in candidates:
        k = np.clip(candidate, 0, len(px) - 1)
        dx, dy = px[k] - ax, py[k] - ay
        distance2 = dx * dx + dy * dy
        nearest = np.where(distance2 < best, k, nearest)
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
