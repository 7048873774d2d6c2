"""How a file is to be read: for which firmware and printer, and what to obey."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from hframe_post.gcode.commands import Dialect, Vocabulary, dialect
from hframe_post.printer.settings import Printer, Retraction, Travel

LimitSource = Literal["file", "file-all", "printer"]
Extrusion = Literal["absolute", "relative"]


@dataclass(frozen=True, slots=True)
class ReadOptions:
    """What a reader must know beside the file.

    limits: which of the file's limits lower the printer's: those that its firmware obeys,
    all that are known, or none. extrusion: what E is before the first M82 or M83; None: as
    the file shows. travel: where the path may go; None: anywhere. retraction: what G10 and G11
    do; None: only the firmware knows.
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
        """For a printer. Raises HframeError where its firmware is unknown."""
        firmware = printer.firmware
        vocabulary = Vocabulary.with_names(firmware.harmless, firmware.returns)
        return cls(
            dialect(firmware.dialect), limits, extrusion, printer.travel, vocabulary,
            printer.retraction,
        )  # fmt: skip
