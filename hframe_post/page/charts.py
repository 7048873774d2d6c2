"""A page of measurements for a browser: key figures, charts, notes and facts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from hframe_post.arrays import Array
from hframe_post.page import filled
from hframe_post.version import __version__

WARNING = "WARNING"
MOST_POINTS = 1500  # of a line; no screen shows more


@dataclass(frozen=True, slots=True)
class Curve:
    """A line through x, y (n,); NaN in y is a gap. colour: None for one of the page's own.

    strong: thick, above the others; dashed: for models, in contrast to measurements.
    """

    label: str
    x: Array
    y: Array
    colour: str | None = None
    strong: bool = False
    dashed: bool = False


@dataclass(frozen=True, slots=True)
class Chart:
    """Lines over common axes. x, y: labels of the axes; log: whether each is logarithmic.

    marks: places on the x axis, and what to write there.
    """

    title: str
    x: str
    y: str
    lines: Sequence[Curve]
    log: tuple[bool, bool] = (False, False)
    marks: Sequence[tuple[float, str]] = ()


@dataclass(frozen=True, slots=True)
class Card:
    """A key figure at the top of the page. kind: ``best``, ``bad``, or empty."""

    what: str
    value: str
    unit: str = ""
    more: str = ""
    kind: str = ""


@dataclass(frozen=True, slots=True)
class Section:
    """A heading with charts."""

    title: str
    charts: Sequence[Chart]


def page(
    name: str, lead: str, cards: Sequence[Card], sections: Sequence[Section],
    notes: Sequence[str], facts: Sequence[tuple[str, str]],
) -> bytes:  # fmt: skip
    """Return the page as HTML. lead: the result in one sentence; facts: labels and texts."""
    data = {
        "name": name,
        "version": __version__,
        "lead": lead,
        "cards": [asdict(card) for card in cards],
        "sections": [
            {
                "title": section.title,
                "charts": [_chart(chart) for chart in section.charts],
            }
            for section in sections
        ],
        "warnings": [note.removeprefix(WARNING).lstrip() for note in notes if _warns(note)],
        "notes": [note for note in notes if not _warns(note)],
        "facts": [list(fact) for fact in facts],
    }
    return filled("measured", data)


def _warns(note: str) -> bool:
    return note.startswith(WARNING)


def _chart(chart: Chart) -> dict[str, Any]:
    lines = [
        {"label": line.label, "colour": line.colour, "strong": line.strong, "dashed": line.dashed}
        | _points(line, chart.log)
        for line in chart.lines
    ]
    marks = [{"at": float(f"{at:.5g}"), "text": text} for at, text in chart.marks]
    return {
        "title": chart.title, "x": chart.x, "y": chart.y, "log": chart.log, "lines": lines,
        "marks": marks,
    }  # fmt: skip


def _points(line: Curve, log: tuple[bool, bool]) -> dict[str, Any]:
    """Return a line's points rounded to four digits; of too many, evenly spread ones."""
    valid = np.isfinite(line.x) & ((line.x > 0.0) | (not log[0]))
    x, y = line.x[valid], line.y[valid]
    if len(x) > MOST_POINTS:
        along = np.log(x) if log[0] else x
        wanted = np.linspace(along[0], along[-1], MOST_POINTS)
        kept = np.unique(np.searchsorted(along, wanted).clip(0, len(x) - 1))
        x, y = x[kept], y[kept]
    gap = ~np.isfinite(y) | ((y <= 0.0) & log[1])
    return {
        "at": [float(f"{value:.5g}") for value in x.tolist()],
        "y": [None if missing else float(f"{value:.4g}")
              for value, missing in zip(y.tolist(), gap.tolist(), strict=True)],
    }  # fmt: skip
