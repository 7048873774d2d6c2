"""Where segments end, so that Marlin queues each of them and rounds nothing."""

from __future__ import annotations

import numpy as np

from hframe_post.arrays import Integers
from hframe_post.model.kinematics import Kinematics

MARGIN = 6  # steps of a segment beyond the least, if the command does not stop there
IDLE = 24  # samples without a step that are a standstill


def motor_steps(cells: Integers, kinematics: Kinematics) -> Integers:
    """Steps of the two motors (n − 1, 2) between places (n, 2) in whole steps of x and y."""
    return np.asarray(np.diff(cells @ kinematics.matrix.astype(np.int64).T, axis=0))


def most_steps(steps: Integers) -> Integers:
    """Steps (n,) of the motor that makes most of them, of (n, 2)."""
    return np.asarray(np.abs(steps).max(axis=1))


def segment_ends(steps: Integers, least: int, apart: int, last: bool) -> Integers:
    """Indices, ascending, of the samples at which segments end; 0 is where they begin.

    steps (n, 2): of the motors, from sample to sample. Segments last ``apart`` samples, unless
    the machine stands or a motor turns before, and their leading motor makes ``least`` steps or
    none; last: motion ends at sample n, which must be reached, with fewer steps if it must be.
    """
    path = np.concatenate([[0], np.cumsum(most_steps(steps))])
    n = len(steps)
    following = np.searchsorted(path, path + least + MARGIN)
    following = np.maximum(following, np.arange(n + 1) + apart)
    places = np.vstack([np.zeros((1, 2), dtype=np.int64), np.cumsum(steps, axis=0)])
    turns = [_turns(place, least) for place in places.T]
    stops = np.unique(np.concatenate([_edges_of_standstill(path), *turns, [n]]))
    stop = np.minimum(np.searchsorted(stops, np.arange(n + 1), side="right"), len(stops) - 1)
    ends = _chain(np.minimum(following, stops[stop]))
    while len(drop := _superfluous(ends, places, least, last)):
        ends = np.delete(ends, drop)
    return ends


def _edges_of_standstill(path: Integers) -> Integers:
    """First and last samples of runs in which no motor steps for long, ascending."""
    changes = np.flatnonzero(np.diff(path)) + 1
    first, after = np.append(0, changes), np.append(changes, len(path))
    idle = after - first > IDLE
    return np.unique(np.stack([first[idle], after[idle] - 1]))


def _turns(place: Integers, least: int) -> Integers:
    """Samples at which a motor, at ``place`` (n + 1,), turns after ``least`` steps, for as many.

    A segment across one would cut it off, or make so few steps that it had to be dropped.
    """
    moving = np.flatnonzero(np.diff(place))
    onward = np.sign(np.diff(place)[moving])
    turns = moving[1:][onward[1:] != onward[:-1]]
    while len(turns):
        legs = np.abs(np.diff(place[np.concatenate([[0], turns, [len(place) - 1]])]))
        short = legs < least
        short[1:] &= ~short[:-1]
        j = np.flatnonzero(short)
        if not len(j):
            break
        turns = np.delete(turns, np.unique(np.clip([j - 1, j], 0, len(turns) - 1)))
    return np.asarray(turns)


def _chain(following: Integers) -> Integers:
    """The samples that 0 leads to when each leads to a later one, and the last to itself.

    Steps of 1, 2, 4, … at once: all that are reached by one are reached, twice as far.
    """
    reached = np.zeros(len(following), dtype=bool)
    reached[0] = True
    for _ in range(len(following).bit_length()):
        reached[following[reached]] = True
        following = following[following]
    return np.flatnonzero(reached)[1:]


def _superfluous(ends: Integers, places: Integers, least: int, last: bool) -> Integers:
    """Which ends to drop so that segments of too few steps join a neighbour.

    That is the segment before, by dropping where it ends; but the segment after, where the one
    before is too short itself or stands still. The last end cannot be dropped if it is the
    motion's. Of segments in a row every other one is dealt with: look again.
    """
    steps = most_steps(np.diff(places[np.append(0, ends)], axis=0))
    short = (steps > 0) & (steps < least)
    short[1:] &= ~short[:-1]
    j = np.flatnonzero(short)
    final = last & (j == len(ends) - 1)
    joins_before = (j > 0) & ((steps[j - 1] >= least) | final)
    drop = np.where(joins_before, j - 1, j)
    return drop[drop < len(ends) - 1] if last else drop
