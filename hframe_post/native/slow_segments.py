"""Where segments of slow motion end, so that they miss the command least.

In slow motion the least steps of a segment take longer than the lines in a second allow. If every
segment ends as soon as it can, its chord lies on one side of the command's bends, and the nozzle
follows: on a printer with 500 mm/s² that is most of what whole steps leave. So the ends of a row of
such segments are chosen again, by dynamic programming, for the least sum of squares.
"""

from __future__ import annotations

import numpy as np

from hframe_post.arrays import Array, Integers
from hframe_post.native import kernels
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
    room, froms = np.empty(7 * (n + 1)), np.empty(n + 1, np.int64)
    own = parts, reach, len(reach), least, apart
    kernels.marlin_slow_ends(points, cells, motors, n, *own, room, froms, is_end)
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
