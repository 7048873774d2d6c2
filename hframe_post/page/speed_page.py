"""The page of print time against permitted error."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from hframe_post.page.charts import Card, Chart, Curve, Section, page
from hframe_post.printer.settings import Printer
from hframe_post.studies import speed_curve as speeds
from hframe_post.studies.speed_curve import (
    advice,
    causes,
    recommended,
    shown_feature,
)
from hframe_post.studies.speed_prints import Point
from hframe_post.writers.print_time import duration

TODAY = "as sliced, today"
Points = Sequence[tuple[float, float]]


def speed_page(found: speeds.Curve, printer: Printer, name: str) -> bytes:
    """Return the page of a file's curve as HTML. name: the title."""
    step, before = recommended(found), found.original
    today, wall = max(before.errors.values()), shown_feature(found)
    gain = 1.0 - step.raised.seconds / before.seconds
    cards = [
        Card("As sliced", duration(before.seconds), more=f"{1e3 * today:.0f} µm, worst feature"),
        Card(
            "As exact as today", duration(step.raised.seconds), kind="best",
            more=f"{100.0 * gain:.0f} % faster: --max-error {1e3 * step.bound:.3g}um",
        ),
        Card("With its feed rates", duration(step.kept.seconds), more="only accelerations change"),
        Card("Compensated, same speed", duration(found.own.seconds),
             more=f"{1e3 * found.own.errors.ours.get(wall, 0.0):.1f} µm, {wall}"),
    ]  # fmt: skip
    charts = [_times(found, today), _errors(found, wall)]
    return page(
        name, "What the print would take within each error, what limits it, and how far the "
        "lines' width is off.", cards,
        [Section("Time against error", charts, [_row(step) for step in found.steps])],
        [f"advice  {text}" for text in advice(found)],
        [("profile", printer.name), ("limits", _limits(found))],
    )  # fmt: skip


def _row(step: speeds.Step) -> tuple[str, str]:
    kept, raised = (
        f"{duration(point.seconds)} ({causes(point)}; {100.0 * point.errors.width:.1f} %)"
        for point in (step.kept, step.raised)
    )
    return f"--max-error {1e3 * step.bound:.3g}um", f"{kept}. With --speed-up max: {raised}"


def _limits(found: speeds.Curve) -> str:
    limits = found.limits
    text = f"flow {limits.flow:g} mm³/s, layers of at least {limits.min_layer_time:g} s"
    text += f" at {limits.min_print_speed:g} mm/s or more"
    return text if math.isinf(found.width) else f"{text}, line width {100.0 * found.width:g} %"


def _times(found: speeds.Curve, today: float) -> Chart:
    def line(label: str, of: Callable[[speeds.Step], Point], colour: str) -> Curve:
        points = [(1e3 * step.bound, of(step).seconds / 60.0) for step in found.steps]
        return _curve(label, points, colour)

    lines = [
        line("--speed-up max", lambda step: step.raised, "var(--racking)"),
        line("file's feed rates", lambda step: step.kept, "var(--fbs)"),
        _curve(TODAY, [(1e3 * today, found.original.seconds / 60.0)], "var(--ink)"),
    ]
    return Chart("Print time, min", "permitted error, µm", "", lines, (True, False))


def _errors(found: speeds.Curve, wall: str) -> Chart:
    points = [found.own, *(step.raised for step in found.steps)]
    lines = []
    for label, name, colour in (
        ("compensated", "ours", "var(--racking)"), ("best input shaper", "shaped", "var(--fbs)"),
    ):  # fmt: skip
        errors = [getattr(point.errors, name).get(wall) for point in points]
        known = [(p.seconds / 60.0, 1e3 * e) for p, e in zip(points, errors, strict=True) if e]
        if known:
            lines.append(_curve(label, sorted(known), colour))
    before = found.original.seconds / 60.0, 1e3 * found.original.errors.get(wall, 0.0)
    lines.append(_curve(TODAY, [before], "var(--ink)"))
    return Chart(f"Predicted error of {wall}, µm", "print time, min", "", lines, (False, True))


def _curve(label: str, points: Points, colour: str) -> Curve:
    x, y = np.array(points, dtype=float).T
    return Curve(label, x, y, colour, strong=True)
