"""Whether E is absolute, by the evidence of the moves that follow.

Of a file that never says so, since a macro of the printer does: extrusion is proportional to
the path, so either the E of each move is (relative), or what each adds to the one before.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from hframe_post.arrays import Array
from hframe_post.errors import GcodeError
from hframe_post.gcode.lexer import Line, command, numbers_among

FEWEST = 3  # moves that are evidence
CLEARER = 0.5  # times as much spread as the other reading has, at most
SHORTEST = 0.05  # mm of path; less is mostly rounding


def is_absolute(lines: Iterable[Line]) -> bool | None:
    """What the printing moves of these lines show; None where they show nothing.

    A single E in all of them is the same either way.
    """
    table = np.array(list(_extruding(lines))).reshape(-1, 3)
    if len(table) <= 1:
        return True
    path, e, before = table[table[:, 0] > SHORTEST].T
    relative = e / path
    absolute = ((e - before) / path)[np.isfinite(before)]
    if len(absolute) < FEWEST:
        return None
    by_relative, by_absolute = _spread(relative), _spread(absolute)
    if by_relative < math.inf and by_relative <= CLEARER * by_absolute:
        return False
    return True if by_absolute < math.inf and by_absolute <= CLEARER * by_relative else None


def _spread(ratio: Array) -> float:
    """How unlike the extrusion per mm of printing moves is: about 0 if it is always the same.

    The median deviation from the median, relative to it, and the share of moves that would
    take filament back, as only a few wipes do.
    """
    median = float(np.median(ratio))
    if median <= 0.0:
        return math.inf
    return float(np.median(np.abs(ratio - median))) / median + float((ratio <= 0.0).mean())


def _extruding(lines: Iterable[Line]) -> Iterable[tuple[float, float, float]]:
    """Path, E and the E before (nan: unknown) of moves with E, until M82 or M83."""
    at = {"X": math.nan, "Y": math.nan}
    absolute, before = True, math.nan
    for line in lines:
        try:
            coded = command(line)
            words = numbers_among(line, coded.arguments, "XYE") if coded else {}
        except GcodeError:
            return  # the reader will say so
        if coded is None:
            continue
        if coded.name in ("M82", "M83"):
            return
        if coded.name in ("G90", "G91"):
            absolute = coded.name == "G90"
        elif coded.name == "G92":
            before = words.get("E", before)
        elif coded.name in ("G0", "G1", "G2", "G3"):
            step = {a: v if not absolute else v - at[a] for a, v in words.items() if a != "E"}
            path = math.hypot(*step.values()) if step else 0.0
            at |= {a: at[a] + s if not absolute else words[a] for a, s in step.items()}
            if "E" in words:
                yield path, words["E"], before
            if "E" in words and (path > 0.0 or not math.isfinite(before)):
                before = words["E"]
