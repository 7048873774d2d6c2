"""Joining of the straight pieces of a picture, in C and in numpy."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hframe_post.arrays import Flags, Integers, Z
from hframe_post.native import kernel

PASSES = 4  # of joining pairs, as long as they join an eighth

Table = NDArray[np.float32]


def joined_pieces(
    shape: Table, alike: int, ways: int, length: float, near: float, off: float
) -> Integers:
    """Return where pieces end after neighbours were joined pair by pair.

    shape: x, y; from row ``alike`` on numbers, the bits of int32, that must be equal; in the row
    before ``ways`` whether a piece starts again; then ways off the path. Pieces are joined up to a
    length, if x and y stay ``near`` their line, and the ways are off theirs by less than ``off``.
    """
    kept = np.arange(shape.shape[1])
    if (compiled := kernel("joined_pieces")) is not None:
        rules = alike, ways, length * length, near, off, PASSES
        return kept[: compiled(np.ascontiguousarray(shape), *shape.shape, *rules, kept)]
    for _ in range(PASSES):
        joined = _pairs(shape, alike, ways, length, near, off)
        if joined.any():
            kept, shape = kept[~joined], shape[:, ~joined]
        if 8 * np.count_nonzero(joined) < len(kept):
            break
    return kept


def _pairs(shape: Table, alike: int, ways: int, length: float, near: float, off: float) -> Flags:
    """Return which may be joined to the next, as pairs: alike, and both lines straight."""
    n = shape.shape[1]
    joined = np.zeros(n, dtype=bool)
    if n < 3:
        return joined
    x, y = shape[:Z]
    dx, dy = x[2:] - x[:-2], y[2:] - y[:-2]
    square = dx * dx + dy * dy
    share = (x[1:-1] - x[:-2]) * dx + (y[1:-1] - y[:-2]) * dy
    share /= np.maximum(square, np.float32(1e-12))
    straight = (square <= length * length) & (share >= 0.0) & (share <= 1.0)
    numbers = shape.view(np.int32)[alike:ways]
    for row in numbers[:-1]:
        straight &= row[2:] == row[1:-1]
    begins = numbers[-1] != 0
    straight &= ~(begins[2:] | begins[1:-1])
    for rows, most in ((shape[:Z], near), (shape[ways:], off)):
        for row in rows:
            straight &= np.abs(row[1:-1] - row[:-2] - share * (row[2:] - row[:-2])) <= most
    k = np.arange(1, n - 1)
    first = np.maximum.accumulate(np.where(straight, 0, k))  # the last one that may not
    joined[1:-1] = straight & ((k - first) % 2 == 1)
    return joined
