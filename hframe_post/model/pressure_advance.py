"""Pressure advance: by how much an extruder is ahead of the path, A = K · dE/dt.

========= ================================================================
E         filament along the path, mm, at samples TS apart
K         time by which flow follows the extruder late, s
A         mm by which the extruder is ahead of E
========= ================================================================

Two rules make A:

* ``smoothed`` is Klipper's: E + A is the mean of E + K · dE/dt, with weights that fall from the
  middle to the ends of the smoothing time.
* ``bounded`` is ours, where E itself must contain A. A is 0 at both ends of a line, so that no
  filament is moved into travel or a retraction, and in between within the extruder's limits.

A line is an unbroken row of samples in which x or y moves and filament is fed. Sums are those of
whole numbers, picometres, so that they do not depend on where they begin.
"""

from __future__ import annotations

import numpy as np

from hframe_post.arrays import TS, Array, E, Flags, Integers
from hframe_post.native.judging import sliding_sums

PICO = 1e9  # of a mm
REACH = 250  # samples from which a faster change may come; see ``bounded``
NEAR = 2  # samples before and after one between which its speed is measured


def steepest(velocity: float, acceleration: float, half: Integers | int) -> Array:
    """Return how fast A may change, mm/s, for its mean to stay within an acceleration, mm/s².

    A fifth of that is for the ends of a line, where A sets out at once.
    """
    return np.asarray(np.minimum(velocity, 0.8 * acceleration * half * TS))


def extruding(path: Array) -> Flags:
    """Return which steps (n − 1,) of a path (n, 4) are part of a line."""
    dx, dy, _, fed = np.diff(path, axis=0).T
    return np.asarray((fed > 0.0) & ((dx != 0.0) | (dy != 0.0)))


def smoothed(path: Array, K: Array, half: int) -> Array:
    """Return A (n,) by Klipper's rule, averaged over ``half`` samples before and after each.

    path (n, 4); K (n,): s. It is 0 where the neighbours are not known.
    """
    n, A = len(path), np.zeros(len(path))
    if n <= 2 * half:
        return A
    fed = np.where(extruding(path), np.diff(path[:, E]), 0.0)
    fed = np.append(0.0, fed)  # up to each sample
    j = np.arange(-half, half + 1)
    weight = (half + 1.0 - np.abs(j)) / (half + 1.0) ** 2
    later = np.cumsum(weight[::-1])[::-1]  # weights of samples that have a step behind them
    shift = np.where(j > 0, later, later - 1.0)
    A[half : n - half] = sliding_sums(shift, fed) + sliding_sums(weight, K * fed / TS)
    return np.where(K > 0.0, A, 0.0)  # without advance Klipper does not average either


def bounded(path: Array, K: Array, velocity: float, acceleration: float, half: int) -> Array:
    """Return A (n,) by our rule, averaged over ``half`` samples before and after each.

    path (n, 4); K (n,): s. The extruder stays below velocity (mm/s), and A below acceleration
    (mm/s²), from one few ms to the next: A is lower around changes of speed that are too sudden.
    Lines of less than 2 half samples are averaged over fewer. A is exact from REACH + half + NEAR
    samples on from the ends of the path.
    """
    inside, before, after = _places(path)
    reach = np.clip((before + after) // 2, 1, half)  # shorter on lines that are
    speed = np.zeros(len(path))
    speed[NEAR:-NEAR] = (path[2 * NEAR :, E] - path[: -2 * NEAR, E]) / (2 * NEAR * TS)
    speed = np.where(inside, np.maximum(speed, 0.0), 0.0)
    most = steepest(velocity, acceleration, reach)
    wanted = np.minimum(K * speed, 0.98 * most * TS * (REACH - reach))  # a bit less than fits
    room = np.minimum(np.minimum(before, after) / reach, 1.0)  # sets out gently
    room = np.minimum(most * room, np.maximum(velocity - speed, 0.0))
    slope = np.rint(PICO * TS * np.minimum(room[:-1], room[1:])).astype(np.int64)
    way = np.append(0, np.cumsum(slope))
    rising = np.minimum.accumulate(np.rint(PICO * wanted).astype(np.int64) - way) + way
    both = np.minimum.accumulate((rising + way)[::-1])[::-1] - way
    return np.where(inside, _means(both, before, after, reach) / PICO, 0.0)


def _places(path: Array) -> tuple[Flags, Integers, Integers]:
    """Return which samples (n,) are inside a line, and how far they are from its ends."""
    at, steps = np.arange(len(path)), extruding(path)
    inside = np.append(False, steps) & np.append(steps, False)
    begin = np.maximum.accumulate(np.where(inside, 0, at))
    end = np.minimum.accumulate(np.where(inside, at[-1], at)[::-1])[::-1]
    return inside, at - begin, end - at


def _means(x: Integers, before: Integers, after: Integers, half: Integers) -> Array:
    """Return the mean (n,) of x and ``half`` (n,) neighbours on either side.

    Beyond its ends a line goes on as its reflection, with the sign changed, so that the mean is 0
    at both.
    """
    total, at, last = np.append(0, np.cumsum(x)), np.arange(len(x)), len(x) - 1
    low = at - half + np.where(before < half, 2 * (half - before) + 1, 0)
    high = at + half - np.where(after < half, 2 * (half - after) + 1, 0)
    low, high = np.clip(low, 0, last), np.clip(high, 0, last)
    return np.asarray((total[high + 1] - total[low]) / (2.0 * half + 1.0))
