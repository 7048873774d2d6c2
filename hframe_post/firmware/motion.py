"""How a firmware moves: what the writer must know of it to keep the machine in time."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from enum import Enum
from typing import NamedTuple

import numpy as np

from hframe_post.arrays import Array, Flags, Integers
from hframe_post.firmware.advance import ExtruderLimits
from hframe_post.stream.types import Position, StopRules

SPARED = 0.9  # of the lines that a firmware can take in a second; at all of them it stutters
VELOCITY_HEADROOM = 1.1  # of the belts' limit: what the stream may do, so that it is never limited


class NextTo(Enum):
    """What a dwell is next to."""

    MOTION = "motion in x and y"
    LIFT = "a lift"
    RETRACTION = "a retraction"


Way = tuple[Position, Position]  # of a retraction or a lift, mm: its start and its end


class Stroke(NamedTuple):
    """How a retraction or a lift is asked for: its speed, mm/s, and the seconds that it takes.

    left: speed, mm/s, at which motion may go on from it; 0: from rest. before: a line to write
    before it; after: one that reverts that, after the first segment of the next motion. fastest:
    greatest speed, mm/s, where the next segment must not be faster than this; inf: it may.
    cruise: mm that it then runs at its speed.
    """

    speed: float
    seconds: float
    left: float = 0.0
    before: bytes = b""
    after: bytes = b""
    fastest: float = math.inf
    cruise: float = 0.0

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
