"""Report of the search for the fastest print: text and JSON."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

from hframe_post.conversion.report import Report
from hframe_post.studies.speed.search import Fastest

MEASURES = {"rms": "RMS", "p95": "at 95 %", "peak": "at most"}
CAUSES = {
    "file": "features that keep the file's speed",
    "cooling": "minimum layer time",
    "travel": "travel",
    "flow": "flow of the hot end",
    "extruder": "extruder acceleration",
    "feed": "feed rate",
    "motors": "motors",
    "error": "permitted error",
}


def with_speed(found: Fastest) -> Report:
    """Return the report of the conversion that was found, with what the search found."""
    return replace(found.report, speed=speed_as_json(found), speed_text=speed_as_text(found))


def speed_as_json(found: Fastest) -> dict[str, Any]:
    trial, original = found.trial, found.original
    limited_by = {cause: round(seconds, 3) for cause, seconds in trial.limited_by.items()}
    return {
        "print_time_s": {
            "before": round(original.seconds, 3), "after": round(trial.seconds, 3),
        },
        "measure": found.bound.measure,
        "width_bound_percent": _percent([found.bound.width]),
        "features": {
            name: {
                "bound_um": round(found.bound.limit(name) * 1e3, 4),
                "predicted_um": round(errors[0] * 1e3, 4),
                "under_model_error_um": round(max(errors) * 1e3, 4),
                "width_percent": _percent(trial.widths.get(name)),
                "uncompensated_um": round(original.errors.get(name, 0.0) * 1e3, 4),
                "acceleration": round(trial.settings.acceleration[name], 1),
                "feed": round(trial.settings.feed[name], 3),
            }
            for name, errors in trial.errors.items()
        },
        "limits": {
            "flow": found.printer.limits.flow,
            "min_layer_time_s": found.printer.limits.min_layer_time,
            "min_print_speed": found.printer.limits.min_print_speed,
        },
        "limited_by_s": limited_by,
    }  # fmt: skip


def speed_as_text(found: Fastest) -> str:
    trial, original = found.trial, found.original
    measure, lines = MEASURES[found.bound.measure], list[str]()
    for name, errors in sorted(trial.errors.items()):
        if errors[0] < 1e-5:  # straight lines at one speed, such as those that prime
            continue
        um, worse = errors[0] * 1e3, max(errors) * 1e3
        before = original.errors.get(name, 0.0) * 1e3
        feed = trial.settings.feed[name]
        slower = f"; at {100.0 * feed:.0f} % of the file's feed" if feed < 1.0 else ""
        lines.append(
            f"error            {name} {um:.0f} µm {measure}, {worse:.0f} with model uncertainty; "
            f"{found.bound.limit(name) * 1e3:.0f} permitted; {before:.0f} without hframe-post"
            f"{slower}"
        )
    lines += [
        f"width            {name} off by {100.0 * widths[0]:.1f} % {measure}, "
        f"{100.0 * max(widths):.1f} with model uncertainty; {100.0 * found.bound.width:g} permitted"
        for name, widths in sorted(trial.widths.items())
    ]
    total = sum(trial.limited_by.values()) or 1.0
    causes = [
        f"{CAUSES[cause]} {100.0 * seconds / total:.0f} %"
        for cause, seconds in sorted(trial.limited_by.items(), key=lambda item: -item[1])
        if seconds > 0.01 * total
    ]
    limits = found.printer.limits
    lines.append(
        f"limits           flow {limits.flow:g} mm³/s, layers of at least "
        f"{limits.min_layer_time:g} s at {limits.min_print_speed:g} mm/s or more (of the profile, "
        "and of the filament as the file has it)"
    )
    lines.append(f"limited by       {', '.join(causes)} of the time")
    return "\n".join(lines)


def _percent(shares: list[float] | None) -> float | None:
    """Return the greatest share in percent; None if nothing is measured or limited."""
    most = max(shares or [math.inf])
    return round(100.0 * most, 3) if math.isfinite(most) else None
