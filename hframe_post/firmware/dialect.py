"""What the commands of a sliced file mean where firmwares differ, and what sets pressure advance.

The pressure in a hot end follows the extruder late, as a filter of first order with a time of
``seconds``. So firmwares command E + seconds · dE/dt.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

from hframe_post.arrays import TS
from hframe_post.printer.settings import (
    MAX_ADVANCE_S,
    MAX_SMOOTHING_S,
    SMOOTH_TIME_S,
    Extruder,
)
from hframe_post.stream.marks import recent

_KLIPPER = re.compile(rb"\s*(?:N\d+\s*)?SET_PRESSURE_ADVANCE\s([^;#*]*)", re.IGNORECASE)
_PARAMETER = re.compile(rb"(\w+)=[\"']?([^\s\"']*)")
_MARLIN = re.compile(rb"\s*(?:N\s*\d+\s*)?M\s*900(?![\d.])([^;(*]*)", re.IGNORECASE)
_WORD = re.compile(rb"([A-Z])\s*(\d*\.?\d*)", re.IGNORECASE)


class AdvanceChange(NamedTuple):
    """What a line sets, s; None: it stays."""

    seconds: float | None = None
    smooth_time: float | None = None


NOTHING = AdvanceChange()


def no_advance(_: bytes) -> AdvanceChange:
    """Return what a line sets where no command sets advance: nothing."""
    return NOTHING


@dataclass(frozen=True, slots=True)
class Advance:
    """The advance in force. smooth_time: s over which it is averaged; reads: what a line sets."""

    seconds: float = 0.0
    smooth_time: float = SMOOTH_TIME_S
    reads: Callable[[bytes], AdvanceChange] = no_advance

    @classmethod
    def of_extruder(
        cls, extruder: Extruder | None, reads: Callable[[bytes], AdvanceChange],
        seconds: float = 0.0,
    ) -> Advance:  # fmt: skip
        """Return the advance of a profile. seconds: where the profile has none."""
        own = extruder or Extruder(seconds)
        return cls(own.advance, own.smooth_time, reads)

    def half(self, computed: bool) -> int:
        """Return the samples over which advance is averaged before and after each.

        Klipper's weights are those of two means in turn, each over half of the time; ours, where E
        is computed to contain the advance, are one.
        """
        return max(round((0.25 if computed else 0.5) * self.smooth_time / TS), 1)

    def after(self, text: bytes) -> Advance:
        """Return what is in force after a line."""
        if (change := self.reads(text)) is NOTHING:
            return self
        seconds = self.seconds if change.seconds is None else change.seconds
        smooth = self.smooth_time if change.smooth_time is None else change.smooth_time
        if (seconds, smooth) == (self.seconds, self.smooth_time):
            return self
        return Advance(seconds, smooth, self.reads)


NO_ADVANCE = Advance()


class ExtruderLimits(NamedTuple):
    """Limits of an extruder whose E contains its advance: speed, mm/s; acceleration, mm/s²."""

    velocity: float
    acceleration: float


@recent
def klipper_advance(text: bytes) -> AdvanceChange:
    """Return what SET_PRESSURE_ADVANCE sets for the extruder that prints."""
    if (match := _KLIPPER.match(text)) is None:
        return NOTHING
    found = {name.upper(): value for name, value in _PARAMETER.findall(match[1])}
    if found.get(b"EXTRUDER", b"extruder") != b"extruder":
        return NOTHING
    return AdvanceChange(
        _within(found.get(b"ADVANCE"), MAX_ADVANCE_S),
        _within(found.get(b"SMOOTH_TIME"), MAX_SMOOTHING_S),
    )


@recent
def klipper_seconds(text: bytes) -> AdvanceChange:
    """Return what SET_PRESSURE_ADVANCE sets where the stream restores its own averaging."""
    change = klipper_advance(text)
    return change if change is NOTHING else change._replace(smooth_time=None)


@recent
def marlin_advance(text: bytes) -> AdvanceChange:
    """Return what M900 sets for the first extruder."""
    if (match := _MARLIN.match(text)) is None:
        return NOTHING
    found = {name.upper(): value for name, value in _WORD.findall(match[1])}
    if _within(found.get(b"T"), 99.0):
        return NOTHING
    return AdvanceChange(_within(found.get(b"K"), MAX_ADVANCE_S))


def _within(text: bytes | None, most: float) -> float | None:
    """Return a number from 0 to ``most``; None for anything else, which firmware refuses."""
    try:
        value = float(text or b"")
    except ValueError:
        return None
    return value if 0.0 <= value <= most else None


# ----------------------------------------------------------------------
# What the commands of a sliced file mean where firmwares differ.

Accelerations = tuple[float, float]  # of moves with and without extrusion, mm/s²
Words = Mapping[str, float]  # of a command: letter → number


_M486 = re.compile(rb"\s*(?:N\d+\s*)?M486\b[^;*]*?S\s*(-?\d+)", re.IGNORECASE)


def object_label(text: bytes) -> bytes | None:
    """Return the number of an object that M486 S begins, -1 for none; None for another line."""
    return match[1] if (match := _M486.match(text)) else None


def one_acceleration(words: Words, before: Accelerations) -> Accelerations:
    """Return S of M204 for all moves."""
    return words.get("S", before[0]), words.get("S", before[1])


def milliseconds(words: Words) -> float:
    """Return P of G4, which is in ms, in seconds; S means nothing."""
    return words.get("P", 0.0) / 1000.0


@dataclass(frozen=True, slots=True)
class Dialect:
    """The meaning of commands where firmwares differ.

    obeyed: the commands that set limits which this firmware obeys.
    accelerations: what M204 sets, given its words and the values before.
    dwell: seconds that G4 waits, given its words.
    has_deviation: corners follow J of M205; elsewhere the lower of X and Y is the speed through a
    right angle.
    g90_sets_e: G90 and G91 set the mode of E as M82 and M83 do. Elsewhere E is relative while
    the file is in G91.
    saves_factor: M220 B saves the speed factor, M220 R restores it, and neither M220 alone changes
    it. Elsewhere M220 without S means 100 %.
    ignores_zero_feed: F of 0 or less means nothing; elsewhere it is an error.
    splines: G5 is supported. cr_ends_lines: a carriage return ends a line, even in a comment.
    soft_endstops: ranges of x, y and z, mm, at whose ends moves of homed axes stop; none: an error.
    retraction_settings: the commands that set what G10 and G11 do.
    may_be_macro: whether a name that the reader does not know may be a macro, which may set modes.
    g92_resets: G92 without words sets all coordinates to 0; elsewhere it does nothing.
    advance: what a line sets of pressure advance.
    label: the object that a line says begins, b"" if it says that one ends; None: no label.
    """

    obeyed: frozenset[str]
    accelerations: Callable[[Words, Accelerations], Accelerations] = one_acceleration
    dwell: Callable[[Words], float] = milliseconds
    has_deviation: bool = False
    retraction_settings: frozenset[str] = frozenset()
    g90_sets_e: bool = False
    saves_factor: bool = False
    ignores_zero_feed: bool = False
    splines: bool = False
    cr_ends_lines: bool = False
    soft_endstops: tuple[tuple[float, float], ...] = ()
    g92_resets: bool = False
    may_be_macro: Callable[[str], bool] = lambda _: False
    label: Callable[[bytes], bytes | None] = object_label
    advance: Callable[[bytes], AdvanceChange] = no_advance
