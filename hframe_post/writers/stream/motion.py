"""Motion as lines of G-code: segments in output units, and their text."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hframe_post.arrays import TS, Array, E, Flags, Integers, Z
from hframe_post.firmware.player import Player, plain
from hframe_post.writers.stream import digits
from hframe_post.writers.stream.sample_buffer import Batch

DWELL = 24  # samples; a longer standstill is a dwell, a shorter one joins the next segment
DECIMALS = (3, 3, 3, 5)  # of x, y, z, e in mm
FEED_DECIMALS = 1  # of F in mm/min


@dataclass(frozen=True, slots=True)
class Units:
    """How finely a place (x, y, z, e) and F are written."""

    decimals: tuple[int, int, int, int]
    feed_decimals: int

    @classmethod
    def of(cls, finer: int = 0) -> Units:
        """A print's; ``finer`` digits more for x, y, z and F."""
        x, y, z, e = DECIMALS
        return cls((x + finer, y + finer, z + finer, e), FEED_DECIMALS + finer)

    @property
    def per_mm(self) -> Array:
        """(4,)."""
        return 10.0 ** np.array(self.decimals)

    @property
    def per_feed(self) -> float:
        """Units of F in a mm/s."""
        return float(60.0 * 10.0**self.feed_decimals)

    def rounded(self, places: Array) -> Integers:
        """Places (..., 4), mm, as they are written."""
        return np.rint(places * self.per_mm).astype(np.int64)


@dataclass(frozen=True, slots=True)
class Segments:
    """k segments in which something moves, and the standstill around them.

    at (k, 4): where each ends, in output units; ends (k,): the point of the batch; T (k,): how
    long it is to last, s; dwell (k,): samples of standstill before it; still: samples of
    standstill after the last.
    """

    at: Integers
    ends: Integers
    T: Array
    dwell: Integers
    still: int

    def __len__(self) -> int:
        return len(self.ends)


def segments(batch: Batch, start: Integers, still: int, player: Player, units: Units) -> Segments:
    """The batch as its firmware wants it.

    start (4,): where the machine stands; still: for how many samples it has. What does not move
    it, when rounded, takes no line: its time joins the next segment, or is a dwell.
    """
    ends, places = player.segments(batch.points, batch.forced, batch.last)
    at = units.rounded(places)
    moved = np.any(np.diff(at[:, :E], axis=0, prepend=start[None, :E]) != 0, axis=1)
    at[moved, E] = at[_extruded_by(moved, ends, np.flatnonzero(batch.forced)), E]
    starts, ends, at = np.concatenate([[0], ends])[:-1][moved], ends[moved], at[moved]
    idle = starts - np.concatenate([[-still], ends])[: len(ends)]
    dwell = np.where(idle >= DWELL, idle, 0)
    left = len(batch) - int(ends[-1]) if len(ends) else still + len(batch)
    return Segments(at, ends, (ends - starts + idle - dwell) * TS, dwell, left)


def _extruded_by(moved: Flags, ends: Integers, marks: Integers) -> Integers:
    """For each segment that moves, the one up to which it extrudes.

    What is extruded in segments too short to move a step of output is extruded with it: up to
    the next segment that moves, or the last that ends before the next mark or at it. ends,
    marks: points of the batch.
    """
    own = np.flatnonzero(moved)
    before_next = np.append(own[1:], len(moved)) - 1
    at_marks = np.append(np.searchsorted(ends, marks, side="right") - 1, len(moved))
    return np.asarray(np.minimum(before_next, at_marks[np.searchsorted(at_marks, own)]))


def lines(
    at: Integers, feeds: Integers, shown: Flags, faster: Flags, units: Units
) -> tuple[bytes, Integers]:
    """G1 lines from place to place, at (k + 1, 4), and where each ends in their text.

    shown (k, 4), faster (k,): the words x, y, z, e and F that are to be seen.
    """
    values = np.vstack([at[1:, :E].T, np.diff(at[:, E]), feeds])
    decimals = (*units.decimals, units.feed_decimals)
    return digits.command_lines(b"G1", b"XYZEF", values, decimals, np.vstack([shown.T, faster]))


def standing_line(start: Integers, end: Integers, feed: int, units: Units) -> bytes:
    """A retraction or lift from a place to another, (4,) each; empty where nothing moves.

    feed: F, in its units.
    """
    dz, de = int(end[Z] - start[Z]), int(end[E] - start[E])
    if not (dz or de):
        return b""
    z = f" Z{plain(end[Z] / units.per_mm[Z], units.decimals[Z])}" if dz else ""
    e = f" E{plain(de / units.per_mm[E], units.decimals[E])}" if de else ""
    return f"G1{z}{e} F{plain(60.0 * feed / units.per_feed, units.feed_decimals)}\n".encode()
