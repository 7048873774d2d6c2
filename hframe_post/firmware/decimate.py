"""A sampled curve as a polyline in time, within a tolerance at every sample."""

from __future__ import annotations

import numpy as np

from hframe_post.arrays import Array, Flags, Integers

LONGEST = 8  # samples in a segment, a power of two


def breakpoints(points: Array, forced: Flags, tolerance: float) -> Integers:
    """Indices of the points to keep, ascending, without the first and with the last one.

    points (n + 1, 4): x, y, z, e one sample apart; forced (n + 1,): points that must stay.
    Segments are the longest of 1, 2, 4 and 8 samples, aligned to multiples of their length,
    whose chord is within ``tolerance`` (mm) of every sample: of x and y together, of z and
    of e.
    """
    n = len(points) - 1
    block = LONGEST * np.arange(-(-n // LONGEST))[:, None] + np.arange(LONGEST + 1)
    P, F = points[np.minimum(block, n)], forced[np.minimum(block, n)]
    F |= block == n
    keep = np.zeros(block.shape, dtype=bool)
    keep[:, LONGEST] = True
    _split(P, F, keep, np.arange(len(block)), 0, LONGEST, tolerance)
    kept = block[keep]
    return kept[kept <= n]


def _split(
    P: Array, F: Flags, keep: Flags, which: Integers, a: int, b: int, tolerance: float
) -> None:
    """Keeps the middle of a … b in those blocks whose chord from a to b does not fit."""
    middle = (a + b) // 2
    which = which[~_fits(P[which, a : b + 1], F[which, a + 1 : b], tolerance)]
    keep[which, middle] = True
    if len(which) and b - a > 2:
        _split(P, F, keep, which, a, middle, tolerance)
        _split(P, F, keep, which, middle, b, tolerance)


def _fits(points: Array, forced: Flags, tolerance: float) -> Flags:
    """Whether the chord of each row of points (r, k, 4) is within the tolerance, (r,)."""
    k = points.shape[1] - 1
    share = (np.arange(1, k) / k)[None, :, None]
    first, last = points[:, :1], points[:, -1:]
    off = points[:, 1:-1] - (first + share * (last - first))
    np.square(off, out=off)
    within = off[..., 0] + off[..., 1] <= tolerance**2
    within &= (off[..., 2] <= tolerance**2) & (off[..., 3] <= tolerance**2)
    return np.asarray(within.all(axis=1) & ~forced.any(axis=1))
