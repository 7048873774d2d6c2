"""Segments for Klipper: samples that stay, vertices, and what is too thick.

1. Neighbouring segments become one, those first that lose least by it, as long as every sample
   stays within the tolerance of its chord (Keogh's bottom-up segmentation, all places at once).
   A straight at constant speed becomes one segment, however long.
2. Chords lie on one side of a bend. So the vertices leave the samples for where the squares of
   what is missed are least.
"""

from __future__ import annotations

import math

import numpy as np

from hframe_post.arrays import TS, Array, Flags, Integers
from hframe_post.native import kernels

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
    n = len(points)
    kept, room, constants = np.empty(n, np.int64), np.empty((6, n)), (SHORT, E_WEIGHT**2, ALIKE)
    count = kernels.breakpoints(points, forced, n, tolerance, *constants, kept, room)
    return kept[1:count]


def fitted(points: Array, ends: Integers) -> Array:
    """Return vertices (k, 4) at ``ends`` (k,) with the least squares of errors in x and y.

    points (n + 1, 4) as for ``breakpoints``; the first and the last stay. No vertex
    goes beyond the samples' least and greatest x and y; z and e are those of its sample.
    """
    n, k = len(points), len(ends)
    vertices = np.empty((k, 4))
    kernels.fitted(np.ascontiguousarray(points), n, ends, k, ROUNDS, vertices, np.empty((6, k)))
    return vertices


def too_thick(points: Array, ends: Integers) -> tuple[Integers, float]:
    """Return which segments Klipper would refuse, and the mm of filament of a piece that it takes.

    The nozzle is estimated from all segments, as lines half as high as wide, at no more than
    USUAL_NOZZLE, since the flow may be high.
    """
    k = len(ends)
    which, most, room = np.empty(k, np.int64), np.empty(1), np.empty(2 * k)
    constants = USUAL_NOZZLE, ALLOWED, FILAMENT
    count = kernels.too_thick(points, len(points), ends, k, *constants, which, most, room)
    return which[:count], float(most[0])


# ----------------------------------------------------------------------
# Rounding of segments to output units.

DWELL = 24  # samples; a longer rest is a dwell, a shorter one joins the next segment


def motion_segments(
    places: Array, ends: Integers, forced: Flags, start: Integers, still: int, per_mm: Array
) -> tuple[Integers, Integers, Array, Integers]:
    """Return places (m + 1, 4), ends (m,), seconds (m,) and dwells (m,) of segments that move.

    places (k, 4): x, y, z, e in mm, at ``ends`` (k,) of points, of which some are ``forced`` to
    separate filament; start (4,): the place before them, in units, for ``still`` samples; per_mm
    (4,): units in a mm. The dwell before a segment is in samples.
    """
    k, n = len(ends), len(forced)
    at, ended, T = np.empty((k + 1, 4), np.int64), np.empty(k, np.int64), np.empty(k)
    dwell = np.empty(k, np.int64)
    count = kernels.motion_segments(
        places, ends, k, forced, n, per_mm, start, still, DWELL, TS, at, ended, T, dwell
    )
    return at[: count + 1], ended[:count], T[:count], dwell[:count]


# ----------------------------------------------------------------------
# Filament at lines of the file.


def misplaced(
    points: Array, ends: Integers, rows: Integers, marked: Integers, e: Array, before: float,
    slack: float,
) -> tuple[int, float]:  # fmt: skip
    """Return the first of m lines with more than ``slack`` mm of filament on its wrong side.

    It is m if there is none. Returns also how many mm are.

    points (n, 4): the path, at whose points ``ends`` (k,) segments end. rows (m,), marked (m,): the
    segment that each line precedes, and its point. e (k + 1,): filament out where segments begin
    and at the last end, mm; before: mm that the path fed before its first point.
    """
    of_lines, off = (rows, np.ascontiguousarray(marked), len(rows)), np.zeros(1)
    path = points, len(points), ends, len(ends)
    return kernels.misplaced(*path, *of_lines, e, float(before), slack, off), float(off[0])
