"""Where segments of slow motion end, so that they miss the command least, in C and in numpy.

In slow motion the least steps of a segment take longer than the lines in a second allow. If every
segment ends as soon as it can, its chord lies on one side of the command's bends, and the nozzle
follows: on a printer with 500 mm/s² that is most of what whole steps leave. So the ends of a row of
such segments are chosen again, by dynamic programming, for the least sum of squares.
"""

from __future__ import annotations

import numpy as np

from hframe_post.arrays import Array, Flags, Integers
from hframe_post.native import kernel
from hframe_post.native.whole_steps import most_steps

SLOW = 2  # samples by which a segment is longer than it need be for the lines in a second
REACH = 2  # times the longest segment of a run that a new one may be
AXES = 2


def slow_segment_ends(
    points: Array, cells: Integers, motors: Integers, ends: Integers, least: int, apart: int
) -> Integers:
    """Return the ends (k,) of segments, with others in slow motion.

    points (n + 1, 2): the command, in steps of x and y; cells (n + 1, 2): the whole steps
    next to it; motors (n + 1, 2): where these put the motors; least, apart: see ``segment_ends``.
    """
    parts, reach = _runs(motors, ends, least, apart)
    if not len(reach):
        return ends
    n, is_end = len(cells) - 1, np.zeros(len(cells), dtype=bool)
    is_end[ends] = True
    if (compiled := kernel("marlin_slow_ends")) is not None:
        room, froms = np.empty(7 * (n + 1)), np.empty(n + 1, np.int64)
        own = parts, reach, len(reach), least, apart
        compiled(points, cells, motors, n, *own, room, froms, is_end)
        return is_end.nonzero()[0]
    first = 0
    for (gap, long), most in zip(parts.tolist(), reach.tolist(), strict=True):
        first += gap
        run = slice(first, first + long + 1)
        _mark_best(points[run], cells[run], motors[run], is_end[run], least, apart, most)
        first += long
    return is_end.nonzero()[0]


def _runs(motors: Integers, ends: Integers, least: int, apart: int) -> tuple[Integers, Integers]:
    """Return runs of slow segments with a neighbour at each end: (r, 2), and their reach, (r,).

    The samples before each run, since the last one, and those in it.
    """
    at = np.append(0, ends)
    long = at[1:] - at[:-1]
    whole = most_steps(np.diff(motors[at], axis=0)) >= least
    slow = np.zeros(len(ends) + 2, dtype=bool)
    slow[1:-1] = whole & (long >= apart + SLOW)
    chosen = (slow[:-2] | slow[1:-1] | slow[2:]) & whole
    edge = np.flatnonzero(np.diff(chosen, prepend=False, append=False))
    first, last = edge[::2], edge[1::2]
    parts = np.diff(np.stack([at[first], at[last]], axis=1).ravel(), prepend=0).reshape(-1, 2)
    longest = np.maximum.reduceat(long, edge[edge < len(long)])[::2] if len(edge) else first
    return parts, REACH * longest


def _mark_best(
    points: Array,
    cells: Integers,
    motors: Integers,
    is_end: Flags,
    least: int,
    apart: int,
    reach: int,
) -> None:
    """Mark the best ends of a run (n + 1,), if there are any, between its first and its last."""
    n, at = len(points) - 1, points - points[0]
    index = np.arange(float(n))[:, None]
    terms = at[:-1], at[:-1] * index, at[:-1] * at[:-1]
    sums = np.stack([np.cumsum(np.vstack([np.zeros(AXES), term]), axis=0) for term in terms])
    cost, before = np.full(n + 1, np.inf), np.full(n + 1, -1)
    cost[0], before[0] = 0.0, 0
    for i in range(apart, n + 1):
        T = np.arange(apart, min(i, reach) + 1)
        T = T[most_steps(motors[i] - motors[i - T]) >= least]
        if len(T):
            j = i - T[2 * T[0] >= T]  # the shortest possible one comes first
            x, y = _missed(cells - points[0], cells, sums, j, i).T
            total = cost[j] + np.maximum(x + y, 0.0)
            best = int(total.argmin())
            cost[i], before[i] = total[best], j[best] if total[best] < np.inf else -1
    if before[n] < 0:
        return
    is_end[1:n] = False
    while (n := int(before[n])) > 0:
        is_end[n] = True


def _missed(off: Array, cells: Integers, sums: Array, j: Integers, i: int) -> Array:
    """Return the squares of what segments from samples j (m,) to i miss, summed, (m, 2).

    off, cells (n + 1, 2): places of the ends, from the first sample and in steps; sums
    (3, n + 1, 2): of the samples before each: the command, by index, squared.
    """
    T = (i - j).astype(np.float64)[:, None]
    a, v = off[j], (cells[i] - cells[j]) / T
    c, by_index, squared = sums[:, i : i + 1] - sums[:, j]
    u = T * (T - 1.0) / 2.0
    line = (a * a * T + 2.0 * a * v * u) + v * v * u * (2.0 * T - 1.0) / 3.0
    return np.asarray((line + squared) - 2.0 * (a * c + v * (by_index - j[:, None] * c)))
