"""Checks of every sample of a command, in C and in numpy."""

from __future__ import annotations

import numpy as np

from hframe_post.arrays import TS, Array, X, Y, Z
from hframe_post.native import kernel


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
    if (compiled := kernel("safe")) is not None:
        return bool(compiled(xyze, command, len(command), before, limits, belts, TS, peaks))
    if not (np.isfinite(xyze).all() and np.isfinite(command).all()):
        return False
    known = np.concatenate([before, command])
    places = xyze[:, Z], *known[1:].T
    low, high = (np.array([*map(bound, places)]) for bound in (np.min, np.max))
    steps = (known[1:] - known[:-1]).T
    velocity, acceleration = steps[:, 1:] / TS, (steps[:, 1:] - steps[:, :-1]) / (TS * TS)
    rates = *(np.abs(_of_belts(belts, *each)) for each in (velocity, acceleration)), *acceleration
    greatest = np.array([np.abs(rate).max() for rate in rates])
    on_bed = (low >= limits[:6:2]) & (high <= limits[1:6:2])
    if not on_bed.all() or (greatest[:2] > limits[6:]).any():
        return False
    np.maximum(peaks, greatest, out=peaks)
    before[:] = known[-2:]
    return True


def _of_belts(belts: Array, x: Array, y: Array) -> Array:
    """Return the rates of both belts, (2, n), for those in x and y (n,)."""
    (ax, ay), (bx, by) = belts.tolist()
    return np.stack([ax * x + ay * y, bx * x + by * y])


def farthest(xyze: Array, command: Array) -> int:
    """Return the sample whose command is farthest from the path, or one without a number."""
    if (compiled := kernel("farthest")) is not None:
        return compiled(xyze, np.ascontiguousarray(command), len(command))
    dx, dy = (command[:, axis] - xyze[:, axis] for axis in (X, Y))
    return int((dx * dx + dy * dy).argmax())
