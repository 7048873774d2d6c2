"""What a stop is judged by: the nozzle's distance to the path, most of all while it extrudes.

Symbols are those of ``model.stop``.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from hframe_post.arrays import Array, Flags, Integers

BESIDE = 100  # samples before and after a hold in which its command may change
BEYOND = 100  # samples after these that are judged too: ringing shows there

# weights of a sample's squared deviation across the path; 1 while it extrudes
TRAVELLING = 0.03  # while it does not
STANDING = 0.04  # in the hold
ARRIVING = 1.0  # at the end of a hold from which an extrusion begins
SOON = 25  # samples after a hold in which that extrusion begins


def _thinned(n: int) -> tuple[Integers, Array]:
    """Return which of n samples next to a hold are judged, nearest first, and for how many each."""
    near, middle, far = np.arange(24), np.arange(24, 60, 2), np.arange(60, n, 4)
    counted = np.repeat([1.0, 2.0, 4.0], [len(near), len(middle), len(far)])
    return np.concatenate([near, middle, far]), counted


BEFORE, COUNTED_BEFORE = (each[::-1] for each in _thinned(BESIDE))
BEFORE = BESIDE - 1 - BEFORE  # counted from sample a − BESIDE
AFTER, COUNTED_AFTER = _thinned(BESIDE + BEYOND)  # counted from sample b


@lru_cache(maxsize=128)
def judged(n: int) -> Integers:
    """Return which samples around a hold of n are judged, counted from BESIDE before it.

    In the hold these are some while the nozzle swings, and the last one.
    """
    hold = BESIDE + np.array([*range(3, min(n, 64) - 1, 4), n - 1] if n else [], np.int64)
    return np.concatenate([BEFORE, hold, BESIDE + n + AFTER])


@lru_cache(maxsize=128)
def _first_weights(n: int) -> Array:
    """Return the weights of the judged samples around a hold of n, if all of them extrude."""
    standing = np.full(len(judged(n)) - len(BEFORE) - len(AFTER), STANDING)
    return np.concatenate([COUNTED_BEFORE, standing, COUNTED_AFTER])


@dataclass(frozen=True, slots=True)
class Stop:
    """A stop in a stretch of samples: the command stands from sample a to b − 1.

    before, after: samples on either side that may change; movable: whether the place of the hold
    may. ends: the first sample after b that is not judged, because another stop begins there.
    """

    a: int
    b: int
    before: int
    after: int
    movable: bool
    ends: int


@dataclass(frozen=True, slots=True)
class Surroundings:
    """n samples of a stretch: path (n, 2) from its origin (2,), mm; extruding (n,)."""

    path: Array
    origin: Array
    extruding: Flags


@dataclass(frozen=True, slots=True)
class Rows:
    """The r judged samples around a hold and in it, in the order of time.

    path (n, 2): of the stretch; index (r,): their places in it; held: which are in the hold, where
    the path stands; weight (r,); extruding (r,): which count as printed.
    """

    path: Array
    index: Integers
    held: slice
    weight: Array
    extruding: Flags

    @classmethod
    def from_stop(cls, around: Surroundings, stop: Stop) -> Rows:
        """Return the rows of a stop with their first weights."""
        a, n = stop.a, stop.b - stop.a
        index = a - BESIDE + judged(n)
        held = slice(len(BEFORE), len(index) - len(AFTER))
        weight = _first_weights(n).copy()
        if not stop.after:
            weight[held.stop :] = 0.0
        extruding = around.extruding[index]
        extruding[held] = False
        weight[~extruding] *= TRAVELLING
        weight[(index >= stop.ends) | (index < a - stop.before)] = 0.0
        extruding &= weight > 0.0
        weight[held] = STANDING
        if n and around.extruding[stop.b : stop.b + SOON].any():
            weight[held.stop - 1] = ARRIVING
        return cls(around.path, index, held, weight, extruding)
