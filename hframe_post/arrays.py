"""Array types, their columns and the sampling time, named once."""

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
