"""Rounding of segments to output units."""

from __future__ import annotations

import numpy as np

from hframe_post.arrays import TS, Array, Flags, Integers
from hframe_post.native import kernels

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
