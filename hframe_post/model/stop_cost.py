"""What a stop is judged by: the nozzle's distance to the path, most of all while it extrudes.

Symbols are those of ``model.stop_solver``.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from hframe_post.arrays import Array, Flags, Integers

BESIDE = 100  # samples before and after a dwell in which its command may change
BEYOND = 100  # samples after these that are judged too: ringing shows there

# weights of a sample's squared deviation across the path; 1 while it extrudes
TRAVELLING = 0.03  # while it does not
DWELLING = 0.04  # in the dwell
ARRIVING = 1.0  # at the end of a dwell from which an extrusion begins
SOON = 25  # samples after a dwell in which that extrusion begins


def _thinned(n: int) -> tuple[Integers, Array]:
    """Return which of n samples next to a dwell are judged, nearest first, and what each counts."""
    near, middle, far = np.arange(24), np.arange(24, 60, 2), np.arange(60, n, 4)
    counted = np.repeat([1.0, 2.0, 4.0], [len(near), len(middle), len(far)])
    return np.concatenate([near, middle, far]), counted


BEFORE, COUNTED_BEFORE = (each[::-1] for each in _thinned(BESIDE))
BEFORE = BESIDE - 1 - BEFORE  # counted from sample a − BESIDE
AFTER, COUNTED_AFTER = _thinned(BESIDE + BEYOND)  # counted from sample b


@lru_cache(maxsize=128)
def judged(n: int) -> Integers:
    """Return which samples around a dwell of n are judged, counted from BESIDE before it.

    In the dwell these are some while the nozzle swings, and the last one.
    """
    dwell = BESIDE + np.array([*range(3, min(n, 64) - 1, 4), n - 1] if n else [], np.int64)
    return np.concatenate([BEFORE, dwell, BESIDE + n + AFTER])


@lru_cache(maxsize=128)
def _first_weights(n: int) -> Array:
    """Return the weights of the judged samples around a dwell of n, if all of them extrude."""
    dwelling = np.full(len(judged(n)) - len(BEFORE) - len(AFTER), DWELLING)
    return np.concatenate([COUNTED_BEFORE, dwelling, COUNTED_AFTER])


@dataclass(frozen=True, slots=True)
class Stop:
    """A stop in a stretch of samples: the command dwells from sample a to b − 1.

    before, after: samples on either side that may change; movable: whether the place of the dwell
    may. ends: the first sample after b that is not judged, because another stop begins there.
    """

    a: int
    b: int
    before: int
    after: int
    movable: bool
    ends: int

    def counted_from(self, first: int) -> Stop:
        """Return the same stop with its samples counted from another one."""
        a, b, ends = self.a - first, self.b - first, self.ends - first
        return Stop(a, b, self.before, self.after, self.movable, ends)


@dataclass(frozen=True, slots=True)
class Surroundings:
    """n samples of a stretch: path (n, 2) from its origin (2,), mm; extruding (n,)."""

    path: Array
    origin: Array
    extruding: Flags


@dataclass(frozen=True, slots=True)
class Rows:
    """The r judged samples around a dwell and in it, in the order of time.

    path (n, 2): of the stretch; index (r,): their places in it; dwell: those in the dwell, where
    the path is at rest; weight (r,); extruding (r,): which count as printed.
    """

    path: Array
    index: Integers
    dwell: slice
    weight: Array
    extruding: Flags

    @classmethod
    def from_stop(cls, around: Surroundings, stop: Stop) -> Rows:
        """Return the rows of a stop with their first weights."""
        a, n = stop.a, stop.b - stop.a
        index = a - BESIDE + judged(n)
        dwell = slice(len(BEFORE), len(index) - len(AFTER))
        weight = _first_weights(n).copy()
        if not stop.after:
            weight[dwell.stop :] = 0.0
        extruding = around.extruding[index]
        extruding[dwell] = False
        weight[~extruding] *= TRAVELLING
        weight[(index >= stop.ends) | (index < a - stop.before)] = 0.0
        extruding &= weight > 0.0
        weight[dwell] = DWELLING
        if n and around.extruding[stop.b : stop.b + SOON].any():
            weight[dwell.stop - 1] = ARRIVING
        return cls(around.path, index, dwell, weight, extruding)
