"""What Marlin makes of segments, in C and in numpy: blocks in whole steps, within its limits."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hframe_post.arrays import Array, E, Z, lengths
from hframe_post.native import kernel

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
    if (compiled := kernel("marlin_blocks")) is not None:
        k, row = len(at) - 1, np.array(limits)
        n, d, a, corners = np.empty(k), np.empty(k), np.empty(k), np.empty(k + 1)
        compiled(at, k, row, matrix, after, STRAIGHT, n, d, a, corners)
        return Blocks(n, d, a, corners)
    row = np.rint(at / (limits.belt, limits.belt, limits.z, limits.e))
    steps, moved = row[1:] - row[:-1], at[1:] - at[:-1]
    motors = steps[:, :Z] @ matrix.T  # whole numbers: exact in any order
    xy, z, e = np.maximum(*np.abs(motors).T), np.abs(steps[:, Z]), np.abs(steps[:, E])
    n = np.maximum(np.maximum(np.maximum(xy, z), e), 1.0)
    moved[:, :Z] = steps[:, :Z] * limits.belt
    d = lengths(moved[:, :E])
    d = np.where(d > 0.0, d, np.maximum(np.abs(moved[:, E]), limits.belt))
    of_e = np.where(xy + z, limits.e_acceleration, limits.retraction)
    with np.errstate(divide="ignore"):
        a = np.minimum(limits.z_acceleration / limits.z * n / z, of_e / limits.e * n / e)
    a = np.minimum(a, limits.belt_acceleration / limits.belt)
    way = np.column_stack([motors * limits.belt, moved[:, Z:]])
    return Blocks(n, d, a, _corner_speeds(way, a * d / n, limits.deviation, after))


def _corner_speeds(way: Array, a: Array, deviation: float, after: float) -> Array:
    """Return the speeds (k + 1,), mm/s, at which the ends of blocks may be passed.

    way (k, 4): mm of the motors, of z and of filament; a (k,): acceleration along the path.
    """
    if deviation == math.inf or len(way) < 2:
        return np.append(np.full(len(way), math.inf), after)
    unit = way / np.sqrt(np.square(way).sum(axis=1, keepdims=True) + 1e-30)
    cosine = -(unit[:-1] * unit[1:]).sum(axis=1)
    sin_half = np.sqrt(0.5 * (1.0 - np.clip(cosine, -STRAIGHT, STRAIGHT)))
    v2 = deviation * a[1:] * sin_half / (1.0 - sin_half)
    inner = np.where(cosine > STRAIGHT, 0.0, np.sqrt(v2))
    return np.concatenate([[math.inf], inner, [after]])
