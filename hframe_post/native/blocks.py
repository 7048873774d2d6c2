"""What Marlin makes of segments: blocks in whole steps, within its limits."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hframe_post.arrays import Array
from hframe_post.native import kernels

STRAIGHT = 0.999999  # cosine of the angle between two blocks


class Blocks(NamedTuple):
    """Blocks (k,): steps n, mm of path d, acceleration a (steps/s²).

    corners (k + 1,): greatest speeds, mm/s, at which their ends may be passed, or one for all.
    """

    n: Array
    d: Array
    a: Array
    corners: Array | float = math.inf


class BlockLimits(NamedTuple):
    """mm of a step of belts, z and filament, and their greatest accelerations, mm/s².

    retraction: acceleration of filament alone. deviation: junction deviation, mm, which limits
    nothing but a move straight back, where Marlin stops; inf: not even that.
    """

    belt: float
    z: float
    e: float
    belt_acceleration: float
    z_acceleration: float
    e_acceleration: float
    retraction: float
    deviation: float


def blocks_between(at: Array, after: float, limits: BlockLimits, matrix: Array) -> Blocks:
    """Return the blocks between places at (k + 1, 4), mm.

    The first may begin at any speed, the last ends at ``after`` or less. matrix (2, 2): from x, y
    to the motors.
    """
    k, row = len(at) - 1, np.array(limits)
    n, d, a, corners = np.empty(k), np.empty(k), np.empty(k), np.empty(k + 1)
    kernels.marlin_blocks(at, k, row, matrix, after, STRAIGHT, n, d, a, corners)
    return Blocks(n, d, a, corners)
