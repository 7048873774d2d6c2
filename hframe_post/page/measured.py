"""A page of something that was measured: what it came to, charts, words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from hframe_post.arrays import Array
from hframe_post.page.template import filled
from hframe_post.version import __version__

MOST_POINTS = 1500  # of a line: more than a screen has


@dataclass(frozen=True, slots=True)
class Line:
    """x, y: (n,); NaN in y is a gap. colour: None takes one of the page's own.

    strong: thick, above the others; dashed: a model, not a measurement.
    """

    label: str
    x: Array
    y: Array
    colour: str | None = None
    strong: bool = False
    dashed: bool = False


@dataclass(frozen=True, slots=True)
class Chart:
    """Lines over common axes. log: of x and of y."""

    title: str
    x: str
    y: str
    lines: Sequence[Line]
    log: tuple[bool, bool] = (False, False)


@dataclass(frozen=True, slots=True)
class Card:
    """A figure at the head of the page. kind: ``best``, ``bad`` or nothing in particular."""

    what: str
    value: str
    unit: str = ""
    more: str = ""
    kind: str = ""


@dataclass(frozen=True, slots=True)
class Section:
    """Charts that belong together; every point of their lines can be read."""

    title: str
    charts: Sequence[Chart]


def page(
    name: str, lead: str, cards: Sequence[Card], sections: Sequence[Section],
    notes: Sequence[str], facts: Sequence[tuple[str, str]],
) -> bytes:  # fmt: skip
    """The page. lead: what it came to, a sentence; notes: in words, a line each."""
    data = {
        "name": name,
        "version": __version__,
        "lead": lead,
        "cards": [asdict(card) for card in cards],
        "sections": [
            {"title": section.title, "charts": [_chart(chart) for chart in section.charts]}
            for section in sections
        ],
        "notes": list(notes),
        "facts": [list(fact) for fact in facts],
    }
    return filled("measured", data)


def _chart(chart: Chart) -> dict[str, Any]:
    lines = [
        {"label": line.label, "colour": line.colour, "strong": line.strong, "dashed": line.dashed}
        | _points(line, chart.log)
        for line in chart.lines
    ]
    return {"title": chart.title, "x": chart.x, "y": chart.y, "log": chart.log, "lines": lines}


def _points(line: Line, log: tuple[bool, bool]) -> dict[str, Any]:
    """Four digits; of too many points those that are evenly spread along the axis."""
    drawn = np.isfinite(line.x) & ((line.x > 0.0) | (not log[0]))
    x, y = line.x[drawn], line.y[drawn]
    if len(x) > MOST_POINTS:
        along = np.log(x) if log[0] else x
        wanted = np.linspace(along[0], along[-1], MOST_POINTS)
        kept = np.unique(np.searchsorted(along, wanted).clip(0, len(x) - 1))
        x, y = x[kept], y[kept]
    gap = ~np.isfinite(y) | ((y <= 0.0) & log[1])
    return {
        "at": [float(f"{value:.5g}") for value in x.tolist()],
        "y": [None if lost else float(f"{value:.4g}")
              for value, lost in zip(y.tolist(), gap.tolist(), strict=True)],
    }  # fmt: skip
