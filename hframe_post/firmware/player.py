"""What the writer asks of a firmware, and the words that all of them share."""

from __future__ import annotations

from enum import Enum
from typing import Protocol

from hframe_post.arrays import Array, Flags, Integers
from hframe_post.stream.types import ModalState


class Beside(Enum):
    """What a wait stands next to."""

    MOTION = "motion in x and y, or a retraction"
    LIFT = "a lift that follows"
    LIFTED = "a lift that has been"


class Player(Protocol):
    """A firmware as the writer meets it: commands, segments, feed rates, waiting."""

    def begin(self, offset: tuple[float, float, float], at: Array) -> list[bytes]:
        """From the user's limits and modes to the stream's.

        offset: x, y, z of the user's G92; at (4,): x, y, z, e where the machine stands.
        """

    def end(self, state: ModalState, at: Array) -> list[bytes]:
        """Back to the user's limits and to the modes and places that the file believes in."""

    def reassert(self, code: bytes) -> bytes:
        """Lines that bring the stream's modes back after a G or M ``code`` of the file's."""

    def fresh_filament(self) -> bytes:
        """A line that lets the firmware count filament anew, if it should now and then."""

    def segments(self, points: Array, forced: Flags, last: bool) -> tuple[Integers, Array]:
        """Where segments end: indices (k,) of the points, ascending, and places (k, 4).

        points (n + 1, 4): x, y, z, e one sample apart, of which the first is written already;
        forced (n + 1,): points at which something else is to be written; last: motion ends at
        the last point, which must be reached. Places are in mm.
        """

    def times(self, at: Array, T: Array) -> Array:
        """Time (k,) that the segments between places at (k + 1, 4), mm, get of T (k,)."""

    def speeds(self, at: Array, T: Array, rest: Flags, before: float) -> Array:
        """Speeds (k,), mm/s, to ask for so that segments take the time T (k,).

        rest (k + 1,): whether the machine stands at each end; before: speed asked for in the
        segment that precedes, 0 if none does.
        """

    def durations(self, at: Array, v: Array, rest: Flags, before: float) -> Array:
        """Time (k,) that segments take when speeds v (k,) are asked for."""

    def wait(self, seconds: float, beside: Beside) -> tuple[bytes, float] | None:
        """Lines for a standstill, and how long it lasts; None: none is made."""


def plain(value: float, decimals: int) -> str:
    """A number without exponent, trailing zeros or negative zero."""
    text = f"{value:.{decimals}f}"
    if "." in text:
        text = text.rstrip("0").rstrip(".")
    return "0" if text in ("-0", "") else text


def named(offset: tuple[float, float, float], at: Array) -> list[str]:
    """G92 that names the place ``at``, of the axes whose name is not the machine's."""
    words = [f"{a}{plain(p, 3)}" for a, p, o in zip("XYZ", at, offset, strict=False) if o]
    return [" ".join(["G92", *words])] if words else []
