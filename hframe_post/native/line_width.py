"""How far a printed line's width is off, piece by piece."""

from __future__ import annotations

import numpy as np

from hframe_post.arrays import Array, Integers
from hframe_post.native import kernels

WAY = 0  # of a piece's sums: the nozzle's way; filament laid; filament wanted


def line_pieces(
    path: Array, nozzle: Array, laid: Array, piece: float, begun: Array
) -> tuple[Integers, Array, Array]:
    """Return before which samples (k,) pieces end, |w − 1| (k,) of each, and the open piece.

    path (n, 4), nozzle (n, 2): the first sample is the last one of before. laid (n,): filament that
    comes out in the step to each. w: filament laid over filament wanted, which is what the path's
    flow would lay on the nozzle's way. A line ends where
    the path stands or nothing is extruded. Its pieces are ``piece`` long, in mm of the nozzle's
    way, and a rest of less than half does not count. begun (4,): how far an open piece is beyond
    the place where it should have begun, and its sums; zeros if none is open.
    """
    n, after = len(path), begun.copy()
    if n < 2:
        return np.zeros(0, np.int64), np.zeros(0), after
    at, errors = np.empty(n, np.int64), np.empty(n)
    nozzle = np.ascontiguousarray(nozzle)
    count = kernels.line_pieces(path, nozzle, laid, n, piece, after, at, errors)
    return at[:count], errors[:count], after
