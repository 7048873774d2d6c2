"""Segments for Klipper, in C and in numpy: samples that stay, vertices, and what is too thick.

1. Neighbouring segments become one, those first that lose least by it, as long as every sample
   stays within the tolerance of its chord (Keogh's bottom-up segmentation, all places at once).
   A straight at constant speed becomes one segment, however long.
2. Chords lie on one side of a bend. So the vertices leave the samples for where the squares of
   what is missed are least.
"""

from __future__ import annotations

import math

import numpy as np

from hframe_post.arrays import Array, E, Flags, Integers, X, Y, Z, lengths
from hframe_post.native import kernel

FILAMENT = math.pi * 1.75**2 / 4.0  # mm², its cross section
USUAL_NOZZLE = 0.4  # mm
ALLOWED = 0.95 * 4.0 * USUAL_NOZZLE**2 / FILAMENT  # mm of filament per mm, with a margin
SHORT = 8  # samples; the nozzle follows longer errors, so that they must be smaller
E_WEIGHT = 4.0  # a mm of filament is wider than a mm of path is long
ALIKE = 1e-4  # mm; losses this close count as equal, for evenness
ROUNDS = 12  # of Jacobi's method, each of which at least halves the error


def breakpoints(points: Array, forced: Flags, tolerance: float) -> Integers:
    """Return indices of the points to keep, ascending, without the first and with the last one.

    points (n + 1, 4): x, y, z, e one sample apart; forced (n + 1,): points that must stay. The
    chord of each segment is within ``tolerance`` (mm) of every sample between: of x and y
    together, of z, and of e within a share 1/E_WEIGHT of it. A segment of n > SHORT samples is
    within √(SHORT/n) of that.
    """
    if (compiled := kernel("breakpoints")) is not None:
        n = len(points)
        kept, room, constants = np.empty(n, np.int64), np.empty((6, n)), (SHORT, E_WEIGHT**2, ALIKE)
        count = compiled(points, forced, n, tolerance, *constants, kept, room)
        return kept[1:count]
    kept, places = np.arange(len(points)), np.zeros(1)
    while len(places) < len(points):  # the bits of each index in reverse; odd ones come first
        places = np.concatenate([2.0 * places + 1.0, 2.0 * places])
    off = np.zeros(len(points) - 1)  # greatest distance of samples from each chord, or more
    while True:
        merged = _merged(points[kept], kept, off)
        cost = merged * np.sqrt(np.maximum((kept[2:] - kept[:-2]) / SHORT, 1.0))
        key = np.full(len(kept), np.inf)  # of equal costs, the lowest place goes first
        key[1:-1] = np.trunc(cost / ALIKE) * len(places) + places[kept[1:-1]]
        key[1:-1][forced[kept[1:-1]] | (cost > tolerance)] = np.inf
        chosen = 1 + np.flatnonzero((key[1:-1] < key[:-2]) & (key[1:-1] < key[2:]))
        if not len(chosen):
            return kept[1:]
        off[chosen - 1] = merged[chosen - 1]
        off, kept = np.delete(off, chosen), np.delete(kept, chosen)


def _merged(vertices: Array, at: Integers, off: Array) -> Array:
    """Return a bound on the distance of samples from the chord of each two segments, (k − 1,).

    vertices (k + 1, 4) at samples ``at``; off (k,): the bound for each segment. A sample's distance
    is at most that from its old chord and that between both chords.
    """
    share = (at[1:-1] - at[:-2]) / (at[2:] - at[:-2])
    apart = vertices[1:-1] - vertices[:-2]
    apart -= share[:, None] * (vertices[2:] - vertices[:-2])
    np.square(apart, out=apart)
    xy = apart[:, X] + apart[:, Y]
    z_e = np.maximum(apart[:, Z], E_WEIGHT**2 * apart[:, E])
    farthest = np.sqrt(np.maximum(xy, z_e))
    return np.asarray(np.maximum(off[:-1], off[1:]) + farthest)


def fitted(points: Array, ends: Integers) -> Array:
    """Return vertices (k, 4) at ``ends`` (k,) with the least squares of errors in x and y.

    points (n + 1, 4) as for ``breakpoints``; the first and the last stay. No vertex
    goes beyond the samples' least and greatest x and y; z and e are those of its sample.
    """
    if (compiled := kernel("fitted")) is not None:
        n, k = len(points), len(ends)
        vertices = np.empty((k, 4))
        compiled(np.ascontiguousarray(points), n, ends, k, ROUNDS, vertices, np.empty((6, k)))
        return vertices
    xy = points[:, :Z]
    start = np.append(0, ends[:-1])
    length = ends - start
    which = np.repeat(np.arange(len(ends)), length)  # the segment of each sample but the first
    share = (np.arange(1, len(xy)) - start[which]) / length[which]
    chord = xy[ends] - xy[start]
    missed = xy[1:] - xy[start][which] - share[:, None] * chord[which]
    later: Array = np.column_stack([np.bincount(which, share * off) for off in missed.T])
    earlier: Array = np.column_stack([np.bincount(which, off) for off in missed.T]) - later
    # sums of s², (1 − s)² and s(1 − s) over each segment, in which s goes from above 0 to 1
    m = length.astype(float)
    last, first = (m + 1) * (2 * m + 1) / (6 * m), (m - 1) * (2 * m - 1) / (6 * m)
    both = (m * m - 1) / (6 * m)
    diagonal = last + np.append(first[1:], 1.0)
    wanted = later + np.vstack([earlier[1:], np.zeros(2)])
    moved = np.zeros((len(ends), 2))
    for _ in range(ROUNDS):
        now = wanted.copy()
        now[1:] -= both[1:, None] * moved[:-1]
        now[:-1] -= both[1:, None] * moved[1:]
        moved = now / diagonal[:, None]
        moved[-1] = 0.0
    vertices = points[ends]
    vertices[:, :Z] = np.clip(vertices[:, :Z] + moved, xy.min(axis=0), xy.max(axis=0))
    return vertices


def too_thick(points: Array, ends: Integers) -> tuple[Integers, float]:
    """Return which segments Klipper would refuse, and the mm of filament of a piece that it takes.

    The nozzle is estimated from all segments, as lines half as high as wide, at no more than
    USUAL_NOZZLE, since the flow may be high.
    """
    if (compiled := kernel("too_thick")) is not None:
        k = len(ends)
        which, most, room = np.empty(k, np.int64), np.empty(1), np.empty(2 * k)
        constants = USUAL_NOZZLE, ALLOWED, FILAMENT
        count = compiled(points, len(points), ends, k, *constants, which, most, room)
        return which[:count], float(most[0])
    start = np.append(0, ends[:-1])
    delta = points[ends] - points[start]
    d, e = lengths(delta[:, :E]), delta[:, E]
    lays = (e > 0.0) & (d > 0.0)
    if not lays.any():
        return np.flatnonzero(lays), 0.0
    usual = float(np.cumsum(e[lays])[-1] / np.cumsum(d[lays])[-1])
    nozzle = min(math.sqrt(2.0 * FILAMENT * usual), USUAL_NOZZLE)
    piece = 2.0 * nozzle * (nozzle * nozzle) / FILAMENT
    limit = min(3.0 * usual, max(ALLOWED, 1.5 * usual))
    return np.flatnonzero((e > piece) & (e > limit * d)), piece
