"""Detection of absolute or relative E, for a file that sets neither (a macro does it).

Extrusion is proportional to the path. So either the E of each move is proportional to its length
(relative), or the difference to the E before is (absolute).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator

import numpy as np

from hframe_post.arrays import Array
from hframe_post.errors import GcodeError
from hframe_post.gcode.lexer import Line, command, numbers_among


def is_absolute(lines: Iterable[Line]) -> bool | None:
    """Return whether the printing moves of these lines show an absolute E; None if unclear.

    A single E in all of them is the same either way.
    """
    table = np.array(list(_extruding_moves(lines))).reshape(-1, 3)
    if len(table) <= 1:
        return True
    path, e, before = table[table[:, 0] > 0.05].T  # mm; shorter moves are mostly rounding
    relative = e / path
    absolute = ((e - before) / path)[np.isfinite(before)]
    if len(absolute) < 3:
        return None
    relative_spread, absolute_spread = _spread(relative), _spread(absolute)
    if relative_spread < math.inf and relative_spread <= 0.5 * absolute_spread:
        return False
    if absolute_spread < math.inf and absolute_spread <= 0.5 * relative_spread:
        return True
    return None


def _spread(ratio: Array) -> float:
    """Return how much the extrusion per mm varies between moves: about 0 if it is constant.

    This is the median deviation from the median, relative to it, plus the share of moves that
    would take filament back, as only a few wipes do.
    """
    median = float(np.median(ratio))
    if median <= 0.0:
        return math.inf
    return float(np.median(np.abs(ratio - median))) / median + float((ratio <= 0.0).mean())


def _extruding_moves(lines: Iterable[Line]) -> Iterator[tuple[float, float, float]]:
    """Yield path length, E and the E before (nan: unknown) of moves with E, up to M82 or M83."""
    at = {"X": math.nan, "Y": math.nan}
    absolute, before = True, math.nan
    for line in lines:
        try:
            coded = command(line)
            words = numbers_among(line, coded.arguments, "XYE") if coded else {}
        except GcodeError:
            return  # the reader reports it when it comes to this line
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
