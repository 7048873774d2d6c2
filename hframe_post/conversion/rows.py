"""Rows of the report of a conversion: a line for people and keys for programs each."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from hframe_post.prediction.statistics import ContourErrors
from hframe_post.writers.print_time import duration

OUTRUN = 1.05  # times its limit, the acceleration of an extruder is worth a line
WORTH_SAYING = 5e-3  # of the print's time, which no owner notices


@dataclass(frozen=True, slots=True)
class Row:
    """A figure of the report. label, text: its line, if any; keys: of the JSON, None for none."""

    label: str
    text: str = ""
    keys: Mapping[str, Any] = field(default_factory=dict)

    def __str__(self) -> str:
        return f"{self.label:17s}{self.text}"


@dataclass(frozen=True, slots=True)
class PrintTime:
    """Duration of the print, s: as the firmware plays the sliced file, and as converted.

    slowed: share of the path that is slower so that the motors can follow. capped: whether limits
    of the profile bind what the file asks.
    """

    before: float = 0.0
    after: float = 0.0
    slowed: float = 0.0
    capped: bool = True

    @property
    def change(self) -> float:
        """Return by which share the print takes longer."""
        return self.after / self.before - 1.0 if self.before else 0.0

    def as_row(self) -> Row:
        """Return both times, and which limits cost the difference if it is worth a word."""
        text = f"{duration(self.before)} → {duration(self.after)} ({100.0 * self.change:+.1f} %)"
        if self.change >= WORTH_SAYING and self.slowed:
            text += f": the limits in [motors], on {percent(self.slowed)} of the path"
        elif self.change >= WORTH_SAYING and self.capped:
            text += ": lower limits in the profile"
        return Row("print time", text, {
            "print_time_s": {"before": round(self.before, 3), "after": round(self.after, 3)},
            "slowed_for_motors_percent": round(100.0 * self.slowed, 2),
        })  # fmt: skip


@dataclass(frozen=True, slots=True)
class AdvanceReport:
    """Pressure advance in the file, s: least and most. computed: E contains it.

    hardest: acceleration, mm/s², that the firmware asks of the extruder; limit: that of the
    profile. slowed: share of lines that accelerate less, for the extruder to follow; to: mm/s², the
    least of them.
    """

    least: float
    most: float
    computed: bool
    hardest: float = 0.0
    limit: float = math.inf
    slowed: float = 0.0
    to: float = math.inf

    def as_rows(self) -> list[Row]:
        """Return a row on the advance, and one on what the extruder cannot follow."""
        values = f"{self.least:.3g}"
        if self.most != self.least:
            values += f" to {self.most:.3g}"
        how = "the firmware's own"
        if self.computed:
            how = "computed into E; the firmware's own is off while the file moves"
        extruder = ""
        if self.slowed:
            extruder = (
                f"{percent(self.slowed)} of the lines accelerate by less, from "
                f"{self.to:.0f} mm/s² on, so that it can follow its advance"
            )
        elif self.hardest > OUTRUN * self.limit:
            extruder = (
                f"its advance asks for up to {self.hardest:.0f} mm/s², more than "
                f"limits.extruder_acceleration ({self.limit:g}): if it skips, raise "
                "extruder.stream_smooth_time or lower limits.acceleration"
            )
        known = {
            "least": self.least, "most": self.most, "computed": self.computed,
            "extruder_mm_s2": round(self.hardest, 1) or None,
            "slowed_path_percent": round(100.0 * self.slowed, 3),
        }  # fmt: skip
        advance = Row("advance", f"{values} s, {how}", {"pressure_advance_s": known})
        return [advance, Row("extruder", extruder)]


def range_as_text(contour: ContourErrors) -> str:
    """Return the RMS error in µm, with its range if it has one."""
    text = f"{1e3 * contour.expected:.1f} µm RMS"
    if (known := contour.range) is None:
        return text
    return f"{text} ({1e3 * known.low:.1f} to {1e3 * known.high:.1f} as the printer changes)"


def percent(share: float) -> str:
    """Return a share as text: whole from 10 % on, below with two digits."""
    value = 100.0 * share
    return f"{value:.0f} %" if value >= 10.0 else f"{value:.2g} %"
