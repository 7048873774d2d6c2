"""Rows of the report of a conversion: a line for people and keys for programs each."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from hframe_post.prediction.statistics import ContourErrors


@dataclass(frozen=True, slots=True)
class Row:
    """A figure of the report. label, text: its line, if any; keys: of the JSON, None for none."""

    label: str
    text: str = ""
    keys: Mapping[str, Any] = field(default_factory=dict)

    def __str__(self) -> str:
        return f"{self.label:17s}{self.text}"


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
