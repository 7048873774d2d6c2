"""Where segments end, so that Marlin queues each of them and rounds nothing."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hframe_post.arrays import Array, Integers
from hframe_post.native import compiled, kernels


def motor_places(cells: Integers, matrix: Array) -> Integers:
    """Return the motors' places (n, 2) at places (n, 2) of x and y, all in whole steps.

    matrix (2, 2): from x, y to the motors.
    """
    return cells @ matrix.astype(np.int64).T


def motor_steps(cells: Integers, matrix: Array) -> Integers:
    """Return the motors' steps (n − 1, 2) between places (n, 2) of x and y in whole steps."""
    return np.asarray(np.diff(motor_places(cells, matrix), axis=0))


def most_steps(steps: Integers) -> Integers:
    """Return the steps (n,) of the motor that makes the most of them, from (n, 2)."""
    return np.asarray(np.maximum(*np.abs(steps).T))  # by columns: rows take ten times as long


@compiled
def segment_ends(motors: Integers, least: int, apart: int, stall: int, last: bool, /) -> Integers:
    """Return the samples, ascending, at which segments end; the first begins at sample 0.

    motors (n + 1, 2): their places. Segments last ``apart`` samples, unless the machine rests or a
    motor turns before, and their leading motor makes ``least`` steps or none; stall: samples by
    which a motor that turns is late; last: motion ends at sample n, which must be reached, with
    fewer steps if it must be.
    """


def with_late_starts(
    ends: Integers, cells: Integers, matrix: Array, least: int, apart: int
) -> tuple[Integers, Integers]:
    """Return ends (k,), more where the command swings before it sets out, and vertices (k + 1, 2).

    cells (n + 1, 2): places of x and y; matrix, least, apart: see the others. A command that swings
    by less than ``least`` steps first comes back to where it rested. One segment for all of that
    would be slow and far off. So the rest goes on until then; or, if it swings by more than half
    of ``least``, a segment of ``least`` steps goes there.
    """
    places = motor_places(cells, matrix)
    starts = np.append(0, ends[:-1])
    moving = most_steps(places[ends] - places[starts]) > 0
    rested = np.append(True, ~moving[:-1])  # so does motion that a batch begins with, perhaps
    found, at = list[int](), list[Integers]()
    for k in (moving & rested).nonzero()[0].tolist():
        start, end = int(starts[k]), int(ends[k])
        away = np.abs(places[start:end] - places[start]).max(axis=1)
        back = int((away <= 1).nonzero()[0][-1])
        if not (away[:back] > 1).any():
            continue
        peak = int((away[:back] == away[:back].max()).nonzero()[0][-1])
        out = int((away[:peak] <= 1).nonzero()[0][-1])
        way = _lengthened(cells[start + peak] - cells[start], matrix, least)
        onward = most_steps(motor_steps(np.stack([cells[start] + way, cells[end]]), matrix))[0]
        swings = 2 * away[peak] > least and min(peak - out, end - start - peak) >= apart
        if swings and onward >= least:
            found += [start + out, start + peak]
            at += [cells[start], cells[start] + way]
        else:
            found.append(start + back)
            at.append(cells[start])
    rows = np.searchsorted(ends, found)
    vertices = np.insert(cells[ends], rows, np.array(at).reshape(-1, 2), axis=0)
    return np.insert(ends, rows, found), np.vstack([cells[:1], vertices])


def _lengthened(way: Integers, matrix: Array, least: int) -> Integers:
    """Return a way (2,) in steps of x and y as long as ``least`` steps of a motor, or one more."""
    exact = way * (least / np.abs(motor_places(way, matrix)).max())
    away = np.sign(way).astype(np.int64)
    longer = np.rint(exact).astype(np.int64)
    short = np.abs(motor_places(longer, matrix)).max() < least
    return np.asarray(longer + away if short else longer)


def without_reversals(vertices: Integers, off: Array, matrix: Array, least: int) -> Integers:
    """Return vertices (k, 2) in whole steps, none of which is left straight back, if possible.

    There Marlin stops, and takes 8 ms or more for the next step. So the vertex after it goes a step
    aside, where the command is: off (k, 2), what is missing to it. matrix (2, 2): from x, y to the
    motors, which make ``least`` steps in both segments at that vertex.
    """
    ways = vertices[1:] - vertices[:-1]
    dot = (ways[1:] * ways[:-1]).sum(axis=1)
    cross = ways[1:, 0] * ways[:-1, 1] - ways[1:, 1] * ways[:-1, 0]
    moved = vertices.copy()
    for first in np.flatnonzero((dot < 0) & (cross == 0)).tolist():
        k = first + 1
        while k < len(moved) - 2 and _turns_back(*(moved[k - 1 : k + 2].tolist())):
            way = np.abs(moved[k + 1] - moved[k])
            aside = int(way[1] <= way[0])  # the axis that moves less
            around = moved[k : k + 3].copy()
            around[1, aside] += 1 if off[k + 1, aside] >= 0.0 else -1
            if most_steps(motor_steps(around, matrix)).min() < least:
                break
            k += 1
            moved[k] = around[1]
    return moved


def _turns_back(before: list[int], at: list[int], after: list[int]) -> bool:
    x, y, u, v = at[0] - before[0], at[1] - before[1], after[0] - at[0], after[1] - at[1]
    return x * v == y * u and x * u + y * v < 0


# ----------------------------------------------------------------------
# What Marlin makes of segments: blocks in whole steps, within its limits.


class Blocks(NamedTuple):
    """Blocks (k,): steps n, mm of path d, acceleration a (steps/s²).

    corners (k + 1,): greatest speeds, mm/s, at which their ends may be passed; none for blocks
    whose speeds at both ends are given.
    """

    n: Array
    d: Array
    a: Array
    corners: Array = np.zeros(0)


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
    return Blocks(*kernels.marlin_blocks(at, np.array(limits), matrix, after))


# ----------------------------------------------------------------------
# Where segments of slow motion end, so that they miss the command least.
#
# In slow motion the least steps of a segment take longer than the lines in a second allow. If every
# segment ends as soon as it can, its chord lies on one side of the command's bends, and the nozzle
# follows: on a printer with 500 mm/s² that is most of what whole steps leave. So the ends of a row
# of such segments are chosen again, by dynamic programming, for the least sum of squares.


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
    is_end = np.zeros(len(cells), dtype=bool)
    is_end[ends] = True
    kernels.marlin_slow_ends(points, cells, motors, parts, reach, least, apart, is_end)
    return is_end.nonzero()[0]


def _runs(motors: Integers, ends: Integers, least: int, apart: int) -> tuple[Integers, Integers]:
    """Return runs of slow segments with a neighbour at each end: (r, 2), and their reach, (r,).

    The samples before each run, since the last one, and those in it.
    """
    at = np.append(0, ends)
    long = at[1:] - at[:-1]
    whole = most_steps(np.diff(motors[at], axis=0)) >= least
    slow = np.zeros(len(ends) + 2, dtype=bool)
    slow[1:-1] = whole & (long >= apart + 2)  # samples longer than it need be for the lines
    chosen = (slow[:-2] | slow[1:-1] | slow[2:]) & whole
    edge = np.flatnonzero(np.diff(chosen, prepend=False, append=False))
    first, last = edge[::2], edge[1::2]
    parts = np.diff(np.stack([at[first], at[last]], axis=1).ravel(), prepend=0).reshape(-1, 2)
    longest = np.maximum.reduceat(long, edge[edge < len(long)])[::2] if len(edge) else first
    return parts, 2 * longest  # that a new segment may have
