"""Array types, their columns and the sampling time, named once."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]
Complex: TypeAlias = NDArray[np.complex128]
Integers: TypeAlias = NDArray[np.int64]
Flags: TypeAlias = NDArray[np.bool_]

TS = 1e-3  # s, the sampling time of the paper and of every profile
X, Y, Z, E = range(4)  # columns of a place


def lengths(steps: Array) -> Array:
    """Return the lengths (n,) of steps (n, 3)."""
    # by columns: a sum along so short an axis takes ten times as long
    x, y, z = steps.T
    return np.asarray(np.sqrt(x * x + y * y + z * z))


def moved(columns: Iterable[Array], by: Array) -> Array:
    """Return places (n, 2) whose x and y, (n,) each, are moved by (2,)."""
    x, y = columns
    out = np.empty((len(x), 2))
    np.add(x, by[X], out=out[:, X])  # by columns, as for lengths
    np.add(y, by[Y], out=out[:, Y])
    return out
