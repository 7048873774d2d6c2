"""What the writer asks of a firmware, and the words that all of them share."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum
from typing import Protocol

from hframe_post.arrays import Array, Flags, Integers
from hframe_post.stream.types import ModalState

VELOCITY_HEADROOM = (
    1.1  # of the belts' limit that the stream may be allowed, so that it is never in the way
)


class Dwelling(Enum):
    """What a dwell stands next to."""

    MOTION = "motion in x and y"
    BEFORE_LIFT = "a lift that follows"
    AFTER_LIFT = "a lift that has been"
    BEFORE_RETRACTION = "a retraction that follows"
    AFTER_RETRACTION = "a retraction that has been"

    @property
    def lifts(self) -> bool:
        """Whether it is a lift."""
        return self in (Dwelling.BEFORE_LIFT, Dwelling.AFTER_LIFT)


@dataclass(frozen=True, slots=True)
class Stroke:
    """How a retraction or a lift is asked for: speed, mm/s, and the time, s, it takes then.

    left: speed, mm/s, at which motion may go on from it; 0: from rest. before: a line that must
    have passed before it; after: one that takes that back, once the first segment of the motion
    that follows has passed.
    """

    speed: float
    seconds: float
    left: float = 0.0
    before: bytes = b""
    after: bytes = b""


@dataclass(frozen=True, slots=True)
class Rejoined:
    """Lines, and where they end: a nudge beside ``at`` (4,), since some move must be.

    speed (mm/s), seconds: of the nudge, to a machine that has left out nothing.
    """

    text: bytes
    at: Array
    speed: float
    seconds: float


class Player(Protocol):
    """A firmware as the writer meets it: commands, segments, feed rates, strokes, dwells."""

    @property
    def lines_per_second(self) -> float:
        """Lines that it can take in a second; inf where nothing bounds them."""

    def begin(self, offset: tuple[float, float, float], at: Array) -> list[bytes]:
        """From the user's limits and modes to the stream's.

        offset: x, y, z of the user's G92; at (4,): x, y, z, e where the machine stands.
        """

    def end(self, state: ModalState, at: Array) -> list[bytes]:
        """Back to the user's limits and to the modes and places that the file believes in."""

    def modes_after(self, name: str) -> bytes:
        """Lines that bring the stream's modes back after a command of the file's, if it needs."""

    def labels_object(self, text: bytes) -> bool:
        """Whether the firmware may leave out the moves before or after a line of the file's."""

    def rejoin(self, at: Array, way: Array, T: float) -> Rejoined | None:
        """Brings a machine, which stands, from where it left out moves to the commands' place.

        at (4,): that, mm; way (2,): x, y of the segment that follows, mm, which lasts T. None:
        it leaves nothing out.
        """

    def reset_extruder(self) -> bytes:
        """A line that lets the firmware count filament anew, if it should now and then."""

    def segments(self, points: Array, forced: Flags, last: bool) -> tuple[Integers, Array]:
        """Where segments end: indices (k,) of the points, ascending, and positions (k, 4).

        points (n + 1, 4): x, y, z, e one sample apart, of which the first is written already;
        forced (n + 1,): points at which something else is to be written; last: motion ends at
        the last point, which must be reached. Positions are in mm.
        """

    def possible_times(self, at: Array, T: Array, before: float) -> Array:
        """T (k,), or the nearest that segments between positions at (k + 1, 4), mm, can last.

        before: see ``feed_rates``.
        """

    def feed_rates(
        self, at: Array, T: Array, rest: Flags, before: float, after: float = math.inf
    ) -> Array:
        """Speeds (k,), mm/s, to ask for so that segments take the time T (k,).

        rest (k + 1,): whether the machine stands at each end; before: feed rate of the segment
        that precedes, 0 if none does; after: greatest speed at the end of the last.
        """

    def durations(
        self, at: Array, v: Array, rest: Flags, before: float, after: float = math.inf
    ) -> Array:
        """Time (k,) that segments take at feed rates v (k,); see ``feed_rates``."""

    def lift_corner(self, at: Array, speed: float) -> float:
        """Greatest speed at which a lift passes from and into motion, mm/s; 0: at rest.

        at (2, 4): from place to place, mm; speed: the user's.
        """

    def stroke(
        self, at: Array, speed: float, seconds: float, wanted: float,
        entry: float = 0.0, leaving: float = 0.0,
    ) -> Stroke:  # fmt: skip
        """A retraction or a lift from a place to another, at (2, 4), mm.

        speed: the user's; seconds: what it takes at that; wanted: what is left for it by now;
        entry, leaving: at which it comes from motion and goes on into motion, 0: from and to rest.
        """

    def dwell(self, seconds: float, beside: Dwelling) -> tuple[bytes, float] | None:
        """Lines for a standstill, and how long it lasts; None: none is made."""


def plain(value: float, decimals: int) -> str:
    """A number without exponent, trailing zeros or negative zero."""
    text = f"{value:.{decimals}f}"
    if "." in text:
        text = text.rstrip("0").rstrip(".")
    return "0" if text in ("-0", "") else text


def coordinates(offset: tuple[float, float, float], at: Array) -> list[str]:
    """G92 that gives the place ``at`` its name, on the axes whose offset is not 0."""
    words = [f"{a}{plain(p, 3)}" for a, p, o in zip("XYZ", at, offset, strict=False) if o]
    return [" ".join(["G92", *words])] if words else []
