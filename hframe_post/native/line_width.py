"""How far a printed line's width is off, piece by piece, in C and in numpy."""

from __future__ import annotations

import numpy as np

from hframe_post.arrays import Array, Flags, Integers
from hframe_post.native import kernel

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
    if (compiled := kernel("line_pieces")) is not None:
        at, errors = np.empty(n, np.int64), np.empty(n)
        count = compiled(path, np.ascontiguousarray(nozzle), laid, n, piece, after, at, errors)
        return at[:count], errors[:count], after
    extrudes, steps = _steps(path, nozzle, laid)
    sums = np.cumsum(np.vstack([begun[1:], steps]), axis=0)  # before each step, and at the end
    drawn = np.append(begun[1] > 0.0, extrudes)  # whether a line is open there
    way, first = sums[:-1, WAY], extrudes & ~drawn[:-1]
    begin = np.maximum.accumulate(np.where(first, way, begun[1] - begun[0]))
    number = np.floor((way - begin) / piece)
    changes = number != np.append(0.0, number[:-1])
    starts = np.flatnonzero(extrudes & (first | changes))
    ends = np.flatnonzero(drawn[:-1] & (~extrudes | changes))
    before = np.vstack([np.zeros(3), sums[starts]])
    ended = sums[ends] - before[np.searchsorted(starts, ends)]
    after[:] = 0.0
    if drawn[-1]:
        after[0] = sums[-1, WAY] - begin[-1] - number[-1] * piece
        after[1:] = sums[-1] - before[-1]
    counts = ended[:, WAY] > 0.5 * piece
    _, laid, wanted = ended[counts].T
    return ends[counts] + 1, np.abs(laid / wanted - 1.0), after


def _steps(path: Array, nozzle: Array, laid: Array) -> tuple[Flags, Array]:
    """Return which steps (n − 1,) extrude, and what they add to a piece's sums, (n − 1, 3)."""
    (dx, dy, _, fed), (vx, vy) = np.diff(path, axis=0).T, np.diff(nozzle, axis=0).T
    extrudes = (fed > 0.0) & ((dx != 0.0) | (dy != 0.0))
    way, length = np.sqrt(vx * vx + vy * vy), np.sqrt(dx * dx + dy * dy)
    flow = np.divide(fed, length, out=np.zeros(len(fed)), where=extrudes)
    steps = np.column_stack([way, laid[1:], flow * way])
    return extrudes, np.where(extrudes[:, None], steps, 0.0)
