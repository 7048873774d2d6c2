"""What the commands of a sliced file mean where firmwares differ."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from hframe_post.firmware.advance import AdvanceChange, no_advance

Accelerations = tuple[float, float]  # of moves with and without extrusion, mm/s²
Words = Mapping[str, float]  # of a command: letter → number


def no_macros(_: str) -> bool:
    """Return whether a command may set modes where owners write none: no."""
    return False


_M486 = re.compile(rb"\s*(?:N\d+\s*)?M486\b[^;*]*?S\s*(-?\d+)", re.IGNORECASE)


def object_label(text: bytes) -> bytes | None:
    """Return the number of an object that M486 S begins, -1 for none; None for another line."""
    return match[1] if (match := _M486.match(text)) else None


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
    may_set_modes: whether a command that the reader does not know may change modes: a macro may.
    g92_resets: G92 without words sets all coordinates to 0; elsewhere it does nothing.
    advance: what a line sets of pressure advance.
    label: the object that a line says begins, b"" if it says that one ends; None: no label.
    """

    obeyed: frozenset[str]
    accelerations: Callable[[Words, Accelerations], Accelerations]
    dwell: Callable[[Words], float]
    has_deviation: bool = False
    retraction_settings: frozenset[str] = frozenset()
    g90_sets_e: bool = False
    saves_factor: bool = False
    ignores_zero_feed: bool = False
    splines: bool = False
    cr_ends_lines: bool = False
    soft_endstops: tuple[tuple[float, float], ...] = ()
    g92_resets: bool = False
    may_set_modes: Callable[[str], bool] = no_macros
    label: Callable[[bytes], bytes | None] = object_label
    advance: Callable[[bytes], AdvanceChange] = no_advance
