"""How a firmware moves: what the writer must know of it to keep the machine in time."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

import numpy as np

from hframe_post.arrays import TS, Array, Flags, Integers
from hframe_post.firmware.code import Code
from hframe_post.firmware.dialect import ExtruderLimits
from hframe_post.stream.types import Position, StopRules

USED_LINES_SHARE = 0.9  # of those that a firmware can take in a second; at all it stutters
DECIMALS = 3  # of x, y and z in mm, as lines have them


class NextTo(Enum):
    """What a dwell is next to."""

    MOTION = "motion in x and y"
    LIFT = "a lift"
    RETRACTION = "a retraction"


class Way(NamedTuple):
    """The way of a retraction or a lift, mm, and its acceleration, mm/s²; inf: the profile's."""

    start: Position
    end: Position
    acceleration: float = math.inf


class Stroke(NamedTuple):
    """How a retraction or a lift is asked for: its speed, mm/s, and the seconds that it takes.

    left: speed, mm/s, at which motion may go on from it; 0: from rest. before: a line to write
    before it; after: one that reverts that, after the first segment of the next motion. fastest:
    greatest speed, mm/s, where the next segment must not be faster than this; inf: it may.
    cruise: mm that it then runs at its speed. limit: a line that sets its acceleration, if the
    firmware needs one.
    """

    speed: float
    seconds: float
    left: float = 0.0
    before: bytes = b""
    after: bytes = b""
    fastest: float = math.inf
    cruise: float = 0.0
    limit: bytes = b""

    def time_of_next(self, d: float, T: float) -> float:
        """Return the seconds of the next segment, d mm, that is to last T.

        Where it would be too fast, both get a speed at which they last as long as planned together.
        """
        late = d / self.speed - T
        if self.fastest == math.inf or late <= 0.0:
            return T
        slowness = max(1.0 / self.speed - late / (d + self.cruise), 1.0 / self.fastest)
        return d * slowness


class MotionRules(ABC):
    """How a firmware moves on a printer: segments, feed rates, strokes, dwells.

    lines_per_second: lines that it can take in a second; inf if nothing limits them. steady:
    segments over which time is kept inside a motion; 0: over a batch. stop_rules: how the command
    passes from motion into lifts and retractions, and back. extruder: limits of an extruder whose
    advance must be part of E; None: the firmware adds its own.
    """

    @property
    def lines_per_second(self) -> float:
        return math.inf

    @property
    def steady(self) -> int:
        return 0

    def head_start(self, at: Array) -> Array:
        """Return the seconds (k,) that segments between places at (k + 1, 4), mm, last longer.

        They are a stream's first motion, which so sets out sooner.
        """
        return np.zeros(len(at) - 1)

    @property
    def stop_rules(self) -> StopRules:
        return StopRules()

    @property
    def extruder(self) -> ExtruderLimits | None:
        return None

    @abstractmethod
    def segments(self, points: Array, forced: Flags, last: bool) -> tuple[Integers, Array]:
        """Return where segments end: indices (k,) of points, ascending, and positions (k, 4), mm.

        points (n + 1, 4): x, y, z, e one sample apart, of which the first is already written;
        forced (n + 1,): points at which another line is to be written; last: motion ends at
        the last point, which must be reached.
        """

    def possible_times(self, at: Array, T: Array, before: float) -> Array:
        """Return T (k,), or the nearest that segments between positions at (k + 1, 4) can last.

        before: see ``feeds``.
        """
        return T

    @abstractmethod
    def feeds(
        self, at: Array, T: Array, rest: Flags, before: float, after: float, per_feed: float
    ) -> tuple[Integers, Array]:
        """Return F (k,) by which segments take the time T (k,), and the seconds that they take.

        F is whole, in units of which a mm/s has ``per_feed``. rest (k + 1,): whether the machine
        rests at each end; before: feed rate of the segment before the first, mm/s, 0 if there is
        none; after: greatest speed at the end of the last.
        """

    @abstractmethod
    def durations(
        self, at: Array, v: Array, rest: Flags, before: float, after: float = math.inf
    ) -> Array:
        """Return the seconds (k,) that segments take at feed rates v (k,), mm/s; see ``feeds``."""

    def entry(self, at: Array, v: float, before: float) -> float:
        """Return the speed, mm/s, at which a segment at feed rate v begins, at (2, 4), mm.

        before: greatest speed at the end of the stroke that precedes it.
        """
        return min(v, before)

    def corners(
        self, way: Way, speed: float, planned: tuple[float, float], previous: Way | None = None
    ) -> tuple[float, float]:
        """Return the greatest speeds, mm/s, of motion into a stroke and on from it; 0: it stops.

        speed: the user's; planned: of z in the plan, where they are certain; previous: the way of
        a stroke that directly precedes it.
        """
        return 0.0, 0.0

    def stroke(
        self, way: Way, speed: float, seconds: float, wanted: float,
        entry: float = 0.0, leaving: float = 0.0,
    ) -> Stroke:  # fmt: skip
        """Return how to make a retraction or a lift.

        speed: the user's; seconds: what it takes at that speed; wanted: seconds left for it;
        entry, leaving: speeds of the motion before and after it, 0: at rest.
        """
        return Stroke(speed, seconds)

    @abstractmethod
    def dwell(self, seconds: float, next_to: NextTo) -> tuple[bytes, float] | None:
        """Return lines for a dwell, and the seconds that they last; None: no dwell."""


# ----------------------------------------------------------------------
# How a firmware plays moves of one axis as they are written, with limits that the file sets.


@dataclass(frozen=True, slots=True)
class WrittenMoves:
    """Moves as a firmware plays them that is exact: no whole steps, ramps of constant acceleration.

    step: mm of which places are multiples; least: steps of the shortest move. reversal: speed,
    mm/s, of two short moves between which an axis turns back, sets out and arrives at once; 0: it
    stops. begin: lines before the first of these moves; after_cancel: what to do where a file of
    them is cancelled.
    """

    code: Code
    step: float = 0.001
    least: int = 10
    reversal: float = 0.0
    begin: tuple[str, ...] = ()
    after_cancel: str = "restart the firmware: until then it keeps this file's limits."

    def limits(self, fastest: float, acceleration: float) -> list[str]:
        """Return lines that set limits, mm and s, with which to turn back is to stop.

        But for a turn at the speed of ``reversal``.
        """
        return self.code.set_limits(fastest, acceleration, 0.0)

    def ahead(self, z: float) -> list[str]:
        """Return lines that make the firmware plan ahead of the first move. z: height, mm."""
        return []

    def speed(self, v: float) -> float:
        """Return the feed rate, mm/s, that the firmware turns into the speed v."""
        return v

    def motion(self, cells: Integers, v: Array, turns: Array, acceleration: float) -> Array:
        """Return the place along one axis (m,), mm every 1 ms, of moves that begin at 0.

        cells (k + 1, 2): their ends, in steps of x and y; v (k,): their feed rates; turns (k + 1,):
        most speed at their ends; acceleration: mm/s².
        """
        d, at = self._along(cells)
        return np.interp(travelled(d, v, turns[:-1], turns[1:], acceleration), *at)

    def _along(self, cells: Integers) -> tuple[Array, tuple[Array, Array]]:
        """Return the lengths (k,) of moves, and path length and place at their ends, mm."""
        way = np.diff(cells, axis=0).sum(axis=1) * self.step
        d = np.abs(way)
        path, place = (np.concatenate([[0.0], np.cumsum(each)]) for each in (d, way))
        return d, (path, place)


def travelled(d: Array, v: Array, v_s: Array, v_e: Array, a: Array | float) -> Array:
    """Return mm of path (m,) every 1 ms, from the start of the first move to the end of the last.

    d, v, v_s, v_e (k,): lengths and speeds of moves, in mm, with ramps of constant acceleration a.
    """
    top = np.minimum(v, np.sqrt(a * d + (v_s**2 + v_e**2) / 2.0))
    up, down = (top - v_s) / a, (top - v_e) / a
    cruise = np.maximum(d - (v_s + top) / 2.0 * up - (v_e + top) / 2.0 * down, 0.0) / top
    ends, path = np.cumsum(up + cruise + down), np.cumsum(d)
    t = np.arange(int(np.ceil(ends[-1] / TS)) + 1) * TS
    k = np.minimum(np.searchsorted(ends, t, side="right"), len(d) - 1)
    tau = np.minimum(t - (ends - up - cruise - down)[k], (up + cruise + down)[k])
    a = np.broadcast_to(a, d.shape)[k]
    rising, falling = np.minimum(tau, up[k]), np.maximum(tau - (up + cruise)[k], 0.0)
    s = v_s[k] * rising + a * rising**2 / 2.0 + top[k] * np.maximum(tau - up[k], 0.0)
    s -= a * falling**2 / 2.0
    return np.asarray((path - d)[k] + np.minimum(s, d[k]))
