"""Rounding of segments to output units, in C and in numpy."""

from __future__ import annotations

import numpy as np

from hframe_post.arrays import TS, Array, E, Flags, Integers
from hframe_post.native import kernel

DWELL = 24  # samples; a longer rest is a dwell, a shorter one joins the next segment


def motion_segments(
    places: Array, ends: Integers, forced: Flags, start: Integers, still: int, per_mm: Array
) -> tuple[Integers, Integers, Array, Integers]:
    """Return places (m + 1, 4), ends (m,), seconds (m,) and dwells (m,) of segments that move.

    places (k, 4): x, y, z, e in mm, at ``ends`` (k,) of points, of which some are ``forced`` to
    separate filament; start (4,): the place before them, in units, for ``still`` samples; per_mm
    (4,): units in a mm. The dwell before a segment is in samples.
    """
    if (compiled := kernel("motion_segments")) is not None:
        k, n = len(ends), len(forced)
        at, ended, T = np.empty((k + 1, 4), np.int64), np.empty(k, np.int64), np.empty(k)
        dwell = np.empty(k, np.int64)
        count = compiled(
            places, ends, k, forced, n, per_mm, start, still, DWELL, TS, at, ended, T, dwell
        )
        return at[: count + 1], ended[:count], T[:count], dwell[:count]
    at = np.vstack([start, np.rint(places * per_mm).astype(np.int64)])
    moved = np.any(np.diff(at[:, :E], axis=0) != 0, axis=1)
    at[1:][moved, E] = at[1:][_extruded_by(moved, ends, np.flatnonzero(forced)), E]
    starts, ends = np.concatenate([[0], ends])[:-1][moved], ends[moved]
    idle = starts - np.concatenate([[-still], ends])[: len(ends)]
    dwell = np.where(idle >= DWELL, idle, 0)
    return at[np.append(True, moved)], ends, (ends - starts + idle - dwell) * TS, dwell


def _extruded_by(moved: Flags, ends: Integers, marks: Integers) -> Integers:
    """Return for each segment that moves the one up to which it extrudes.

    That is the last one before the next segment that moves, or the last that ends before the next
    mark or at it. ends, marks: points of the batch.
    """
    moving = np.flatnonzero(moved)
    before_next = np.append(moving[1:], len(moved)) - 1
    at_marks = np.append(np.searchsorted(ends, marks, side="right") - 1, len(moved))
    return np.asarray(np.minimum(before_next, at_marks[np.searchsorted(at_marks, moving)]))
