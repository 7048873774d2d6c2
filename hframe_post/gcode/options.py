"""How to read a file: its firmware and printer, what to obey, and where the path may go."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal

from hframe_post.errors import LimitError
from hframe_post.gcode.commands import Dialect, Vocabulary, dialect
from hframe_post.gcode.lexer import Line
from hframe_post.printer.settings import Printer, Retraction, Travel

LimitSource = Literal["file", "file-all", "printer"]
Extrusion = Literal["absolute", "relative"]


@dataclass(frozen=True, slots=True)
class ReadOptions:
    """What the reader must know in addition to the file.

    limits: which of the file's limits lower the printer's: those that its firmware obeys,
    all that are known, or none.
    extrusion: what E is before the first M82 or M83; None: detect it.
    travel: where the path may go; None: anywhere.
    retraction: what G10 and G11 do; None: only the firmware knows.
    """

    dialect: Dialect
    limits: LimitSource = "file"
    extrusion: Extrusion | None = None
    travel: Travel | None = None
    vocabulary: Vocabulary = field(default_factory=Vocabulary.with_names)
    retraction: Retraction | None = None

    @classmethod
    def from_printer(
        cls, printer: Printer, limits: LimitSource = "file", extrusion: Extrusion | None = None
    ) -> ReadOptions:
        """Return the options for a printer. Raises HframeError if its firmware is unknown."""
        firmware = printer.firmware
        vocabulary = Vocabulary.with_names(firmware.harmless, firmware.returns)
        return cls(
            dialect(firmware.dialect), limits, extrusion, printer.travel, vocabulary,
            printer.retraction,
        )  # fmt: skip


class Bed:
    """Smallest and largest x, y and z of a path, mm; infinite without ``travel``."""

    def __init__(self, travel: Travel | None) -> None:
        edges = (travel.x, travel.y, travel.z) if travel else (None,) * 3
        self._edges = [edge or (-math.inf, math.inf) for edge in edges]
        rounding = 1e-9  # mm
        self.smallest = [low - rounding for low, _ in self._edges]
        self.largest = [high + rounding for _, high in self._edges]

    def check(self, line: Line, axis: int, value: float) -> None:
        """Raise LimitError if x, y or z (``axis`` 0, 1, 2) is off the bed."""
        if self.smallest[axis] <= value <= self.largest[axis]:
            return
        low, high = self._edges[axis]
        bound = low if value < low else high
        name = "xyz"[axis]
        text = line.text.strip()[:80].decode("latin-1")
        raise LimitError(
            f"{name} of the path (mm)", value, bound, line.number,
            f"{text!r} leads {abs(value - bound):.6g} mm beyond it. Either the file was sliced for "
            f"another printer, or travel.{name} of the profile is too small.",
        )  # fmt: skip
