"""x, y ↔ the two belts of an H-frame: A = x + y, B = x − y."""

from __future__ import annotations

import numpy as np

from hframe_post.arrays import Array


def belts(xy: Array) -> Array:
    """Belt positions (n, 2) of nozzle positions (n, 2), mm."""
    return np.stack([xy[:, 0] + xy[:, 1], xy[:, 0] - xy[:, 1]], axis=1)
