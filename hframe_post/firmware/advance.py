"""Pressure advance: by how much an extruder runs ahead of the path, and the lines that set it.

The pressure in a hot end follows the extruder late, as a filter of first order with a time of
``seconds``. So firmwares command E + seconds · dE/dt.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

from hframe_post.arrays import TS
from hframe_post.printer.settings import (
    MAX_ADVANCE_S,
    MAX_SMOOTHING_S,
    SMOOTH_TIME_S,
    Extruder,
)

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
        change = self.reads(text)
        given = {name: value for name, value in change._asdict().items() if value is not None}
        return replace(self, **given) if given else self


NO_ADVANCE = Advance()


class ExtruderLimits(NamedTuple):
    """Limits of an extruder whose E contains its advance: speed, mm/s; acceleration, mm/s²."""

    velocity: float
    acceleration: float


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


def klipper_seconds(text: bytes) -> AdvanceChange:
    """Return what SET_PRESSURE_ADVANCE sets where the stream restores its own averaging."""
    return klipper_advance(text)._replace(smooth_time=None)


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
