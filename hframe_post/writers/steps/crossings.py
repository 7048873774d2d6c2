"""Times of steps: samples joined by a monotone cubic, and where it crosses half steps.

=========  ============================================================
symbol     meaning
=========  ============================================================
``u``      position in steps plus ½, so that ⌊u⌋ is the rounded position
``m``      tangent of the cubic at a sample, in steps a sample
``s``      share of the interval between two samples, 0 … 1
=========  ============================================================

The tangents are those of Catmull and Rom, limited after Fritsch and Carlson (SIAM J. Numer.
Anal. 17, 1980): between two samples the command never turns back, so the rounded positions
of the samples alone give the number of steps between them.
"""

from __future__ import annotations

import numpy as np

from hframe_post.arrays import Array, Integers


def crossings(u: Array, close: float = 1e-3) -> tuple[Integers, Array, Integers]:
    """Return the steps between the inner n − 2 of n samples u (n,), in order: (k,) each.

    Returns the interval of each (0: after the second sample), its share s there, and its
    direction, 1 or −1. The outer samples only shape the tangents.
    close: steps from a half step that count as on it.
    """
    at = np.floor(u[1:-1]).astype(np.int64)
    change = at[1:] - at[:-1]
    which = np.flatnonzero(change)
    if not len(which):
        return which, np.zeros(0), which
    change, at, start = change[which], at[which], u[which + 1]
    count, heading = np.abs(change), np.sign(change)
    interval = np.repeat(which, count)
    nth = np.arange(len(interval)) - np.repeat(np.cumsum(count) - count, count)
    # upwards the levels are those above ⌊u⌋, downwards ⌊u⌋ itself and those below
    first = np.abs(at + (heading > 0) - start)
    slope = u[1:] - u[:-1]
    before, d, after = (slope[which + k] * heading for k in range(3))
    m0, m1 = tangents(before, d), tangents(d, after)
    c2, c3 = 3.0 * d - 2.0 * m0 - m1, m0 + m1 - 2.0 * d
    c1, c2, c3, level = (np.repeat(column, count) for column in (m0, c2, c3, first))
    return interval, _solved(c1, c2, c3, level + nth, close), np.repeat(heading, count)


def tangents(before: Array, after: Array) -> Array:
    """Return m (n,) at samples between slopes before and after them, (n,) steps a sample each."""
    least = np.minimum(np.abs(before), np.abs(after))
    least *= 3.0  # monotone below (Fritsch and Carlson)
    m = (before + after) / 2.0
    np.minimum(m, least, out=m)
    np.maximum(m, -least, out=m)
    m *= before * after > 0.0
    return m


def _solved(c1: Array, c2: Array, c3: Array, level: Array, close: float) -> Array:
    """Return s (k,) in 0 … 1 at which the rising cubics c1·s + c2·s² + c3·s³ reach ``level``.

    Uses Newton's method from the parabola with the same start and end. Where that does not
    converge (mostly next to a standstill), it halves the interval.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        s = 2.0 * level / (c1 + np.sqrt(c1 * c1 + 4.0 * (c2 + c3) * level))
        for _ in range(3):
            h = c3 * s
            t = h + c2
            h += t
            h *= s
            t *= s
            t += c1
            h += t  # the slope
            t *= s
            t -= level  # what is missing
            t /= h
            s -= t
    off = s * (c1 + s * (c2 + s * c3))
    off -= level
    np.abs(off, out=off)
    arrived = (off <= close) & (s >= 0.0) & (s <= 1.0)
    if not arrived.all():
        few = np.flatnonzero(~arrived)
        s[few] = _halved(c1[few], c2[few], c3[few], level[few])
    return s


def _halved(c1: Array, c2: Array, c3: Array, level: Array) -> Array:
    s = np.full(len(level), 0.5)
    for k in range(2, 40):
        s += np.where(s * (c1 + s * (c2 + s * c3)) < level, 0.5**k, -(0.5**k))
    return s


def spaced(due: Integers, direction: Integers, gap: int, last: int, heading: int) -> Integers:
    """Return the ticks (k,) of one motor's steps in order, none before it is ``due`` (k,).

    At most one step a tick, and ``gap`` ticks from a step to the next in the other direction.
    last, heading: tick and direction of the step before these; 0: there was none.
    """
    turns = np.diff(direction, prepend=heading) != 0
    turns[:1] &= heading != 0
    least = np.where(turns, gap, 1)
    if (np.diff(due, prepend=last) >= least).all():
        return due
    least = np.cumsum(least)
    before = np.concatenate([[last], due - least])
    return np.asarray(np.maximum.accumulate(before)[1:] + least)
