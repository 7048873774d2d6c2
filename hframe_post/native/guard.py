"""Checks of every sample of a command."""

from __future__ import annotations

import numpy as np

from hframe_post.arrays import TS, Array
from hframe_post.native import kernels


def is_safe(
    xyze: Array, command: Array, before: Array, limits: Array, belts: Array, peaks: Array
) -> bool:
    """Return whether a command (n, 2) for a path xyze (n, 4) is finite and within limits.

    before (2, 2): the two samples of the command before it; limits (8,): least and greatest z of
    the path, x and y of the command, then velocity and acceleration of the belts; belts (2, 2):
    from x, y to the belts. Only if it is safe, ``before`` becomes the last two samples, and peaks
    (4,), the greatest velocity and acceleration of the belts and acceleration in x and in y, rise.
    """
    command = np.ascontiguousarray(command)
    return bool(kernels.safe(xyze, command, len(command), before, limits, belts, TS, peaks))


def farthest(xyze: Array, command: Array) -> int:
    """Return the sample whose command is farthest from the path, or one without a number."""
    return int(kernels.farthest(xyze, np.ascontiguousarray(command), len(command)))
