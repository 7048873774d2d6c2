"""x, y ↔ the two belts of an H-frame: A = x + y, B = x − y."""

from __future__ import annotations

import numpy as np

from hframe_post.arrays import Array


def belts(x: Array, y: Array) -> Array:
    """Belt positions A, B, (2, n), at nozzle positions x, y (n,), mm."""
    return np.stack([x + y, x - y])
