"""Joining of the straight pieces of a picture."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hframe_post.arrays import Integers
from hframe_post.native import kernels

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
    rules = alike, ways, length * length, near, off, PASSES
    return kept[: kernels.joined_pieces(np.ascontiguousarray(shape), *shape.shape, *rules, kept)]
