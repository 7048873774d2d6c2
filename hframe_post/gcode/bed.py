"""Where a path may go: an error names the move, how far out it leads, and the profile's key."""

from __future__ import annotations

import math

from hframe_post.errors import LimitError
from hframe_post.gcode.lexer import Line
from hframe_post.printer.settings import Travel

ROUNDING = 1e-9  # mm


class Bed:
    """Least and greatest x, y and z of a path, mm; without a profile's travel it has no edge."""

    def __init__(self, travel: Travel | None) -> None:
        edges = (travel.x, travel.y, travel.z) if travel else (None,) * 3
        self._edges = [edge or (-math.inf, math.inf) for edge in edges]
        (x, x1), (y, y1), (z, z1) = self._edges
        self.least = (x - ROUNDING, y - ROUNDING, z - ROUNDING)
        self.greatest = (x1 + ROUNDING, y1 + ROUNDING, z1 + ROUNDING)

    def check(self, line: Line, axis: int, value: float) -> None:
        """Raises LimitError where x, y or z (``axis`` 0, 1, 2) would be off the bed."""
        low, high = self._edges[axis]
        if self.least[axis] <= value <= self.greatest[axis]:
            return
        bound = low if value < low else high
        name = "xyz"[axis]
        shown = line.text.strip()[:80].decode("latin-1")
        raise LimitError(
            f"{name} of the path (mm)", value, bound, line.number,
            f"{shown!r} leads {abs(value - bound):.6g} mm beyond it: is this a slice for "
            f"another printer, or is travel.{name} of the profile too small?",
        )  # fmt: skip
