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
# while it does not; in the dwell; at the end of a dwell from which an extrusion begins
TRAVELLING, DWELLING, ARRIVING = 0.03, 0.04, 1.0
SHARES = np.array([TRAVELLING, DWELLING, ARRIVING])
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
def judged_rows(n: int) -> tuple[Integers, Array, slice]:
    """Return ``judged``, what each counts if all of them extrude, and those in the dwell."""
    index = judged(n)
    dwell = slice(len(BEFORE), len(index) - len(AFTER))
    dwelling = np.full(dwell.stop - dwell.start, DWELLING)
    return index, np.concatenate([COUNTED_BEFORE, dwelling, COUNTED_AFTER]), dwell


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
