"""Times and speeds of segments with ramps inside, as firmware plans them.

A segment of length d starts at v_s, runs at its cruise speed v and ends at v_e, with ramps of
acceleration a between them. v_s and v_e are the lower of two neighbours' cruise speeds, and no
more than their corner allows; but no less, in some firmware, than a speed at which a segment
begins at least.
"""

from __future__ import annotations

import numpy as np

from hframe_post.arrays import Array, Flags, Integers
from hframe_post.native import compiled, kernels

ROUNDS = 9  # of the speeds' dependence on their neighbours'; 3 leave hard ramps 5 % too fast


def speeds(
    d: Array, T: Array, a: Array, caps: Array | float, before: float, least: Array | float = 0.0
) -> Array:
    """Return the cruise speeds (k,) with which segments d (k,) take the time T (k,).

    a (k,): acceleration; caps (k + 1,), or one: greatest speeds at the ends; before:
    cruise speed of the segment that precedes; least (k,): speeds of entry that neither lowers.
    Solves d = v·T − [(v − v_s)² + (v − v_e)²]/2a. Where nothing does, the ramps are too
    long and the segment takes more than T; not much more, if it is asked for at least d/T.
    """
    v = d / T
    for _ in range(ROUNDS):
        v_s, v_e = ends(v, caps, before, least)
        S = a * T + v_s + v_e
        c = 4.0 * ((v_s * v_s + v_e * v_e) / 2.0 + a * d)
        v = np.maximum((S - np.sqrt(np.maximum(S * S - c, 0.0))) / 2.0, d / T)
    return np.asarray(v)


def durations(
    d: Array, v: Array, a: Array, caps: Array | float, before: float, least: Array | float = 0.0
) -> Array:
    """Return the time (k,) that segments at cruise speeds v (k,) take; see ``speeds``."""
    return seconds(d, v, *ends(v, caps, before, least), a)


def seconds(d: Array, v: Array, v_s: Array | float, v_e: Array | float, a: Array | float) -> Array:
    """Return the time (k,) of segments d (k,) at cruise speeds v (k,) between v_s and v_e."""
    ramps = (np.square(v - v_s) + np.square(v - v_e)) / (2.0 * a)
    return np.asarray((d + ramps) / v)


def ends(
    v: Array, caps: Array | float, before: float, least: Array | float = 0.0
) -> tuple[Array, Array]:
    """Return the speeds (k,) at the start and at the end of each segment.

    Where ``least`` makes the next one begin faster than this one runs, it ends that fast.
    """
    neighbours = np.concatenate([[before], v, v[-1:]])
    joint = np.minimum(np.minimum(neighbours[:-1], neighbours[1:]), caps)
    joint[:-1] = np.maximum(joint[:-1], np.minimum(least, v))
    return joint[:-1], joint[1:]


def klipper_feeds(
    at: Array, T: Array, rest: Flags, before: float, after: float, limits: Array, per_feed: float
) -> tuple[Integers, Array]:
    """Return F (k,) by which Klipper takes the time T (k,) for segments, and what it takes.

    at (k + 1, 4): x, y, z, e at their ends; rest (k + 1,): whether it rests there; before: cruise
    speed of the segment that precedes; after: greatest speed at the last end. limits (8,): velocity
    and acceleration, those in z, those of filament; corner velocity of filament, junction
    deviation. F is whole, in units of which a mm/s has ``per_feed``.
    """
    own = before, after, limits, ROUNDS, per_feed
    F, taken = kernels.klipper_feeds(at, T, rest, *own)
    return F, taken


@compiled
def klipper_durations(
    at: Array, v: Array, rest: Flags, before: float, after: float, limits: Array, /
) -> Array:
    """Return the seconds (k,) that segments take at speeds v (k,); see ``klipper_feeds``."""


def whole_feeds(v: Array, per_feed: float) -> Integers:
    """Return speeds (k,), mm/s, as F is written, in units of which a mm/s has ``per_feed``."""
    return np.asarray(np.maximum(np.rint(v * per_feed), 1.0).astype(np.int64))
