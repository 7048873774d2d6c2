"""Report of print time against permitted error: text, JSON and the charts of a page."""

from __future__ import annotations

import math
from typing import Any

from hframe_post.studies.speed.curve import Curve, Step
from hframe_post.studies.speed.prints import Point
from hframe_post.studies.speed.report import CAUSES, MEASURES
from hframe_post.writers.print_time import duration

WALL = "outer-wall"
NAMED = 0.15  # share of the time from which a cause is named
ADVICE = {
    "feed": "The file's feed rates bind: 'hframe-post convert --speed-up max' raises them",
    "cooling": "The layer time binds ({layer:g} s, limits.min_layer_time): print several parts at "
    "once, or lower it if the part cools faster",
    "flow": "The hot end binds ({flow:g} mm³/s, limits.flow)",
    "motors": "The motors bind (motors.belt_acceleration)",
    "file": "First layers, bridges and skirts keep the file's speed",
    "extruder": "The extruder binds (speed.filament_acceleration)",
}


def curve_as_json(found: Curve) -> dict[str, Any]:
    """Return all figures, ready for ``json.dumps``."""
    shaping = found.shaping
    return {
        "measure": found.measure,
        "width_bound_percent": None if math.isinf(found.width) else 100.0 * found.width,
        "as_sliced": {
            "print_time_s": round(found.original.seconds, 3),
            "error_um": _micrometres(found.original.errors),
        },
        "shaper": None if shaping is None else {"x": shaping.x.name, "y": shaping.y.name},
        "file_speed": _point_as_json(found.own),
        "points": [
            {
                "max_error_um": round(1e3 * step.bound, 3),
                "file_feed_rates": _point_as_json(step.kept),
                "speed_up_max": _point_as_json(step.raised),
            }
            for step in found.steps
        ],
    }


def _point_as_json(point: Point) -> dict[str, Any]:
    return {
        "print_time_s": round(point.seconds, 3),
        "error_um": _micrometres(point.errors.ours),
        "shaper_error_um": _micrometres(point.errors.shaped),
        "line_width_percent": round(100.0 * point.errors.width, 3),
        "limited_by_s": {cause: round(s, 3) for cause, s in point.limited_by.items()},
    }


def _micrometres(errors: dict[str, float]) -> dict[str, float]:
    return {name: round(1e3 * error, 3) for name, error in sorted(errors.items())}


# ---------------------------------------------------------------------- text


def shown_feature(found: Curve) -> str:
    """Return the feature whose error is shown: outer walls, or else the one of largest error."""
    errors = found.original.errors
    return WALL if WALL in errors else max(errors, key=lambda name: errors[name])


def curve_as_text(found: Curve) -> str:
    """Return the table, and what to do about that which binds."""
    name, before = shown_feature(found), found.original
    shaper = f"best shaper ({found.shaping.x.name})" if found.shaping else "best shaper"
    heads = ("--max-error", "print time", name, shaper, "with --speed-up max")
    rows = [
        ["as sliced", duration(before.seconds), _um(before.errors, name), "", ""],
        ["compensated", duration(found.own.seconds), *_errors(found.own, name), ""],
        *(
            [
                f"{1e3 * step.bound:.3g}um", _time(step.kept, before.seconds),
                *_errors(step.kept, name), _time(step.raised, before.seconds),
            ]
            for step in found.steps
        ),
    ]  # fmt: skip
    widths = [max(map(len, column)) for column in zip(heads, *rows, strict=True)]
    lines = [
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in (heads, *rows)
    ]
    held = f"Errors are predicted, {MEASURES[found.measure]}; --max-error holds for each feature."
    return "\n".join([*lines, "", held, *advice(found)])


def advice(found: Curve) -> list[str]:
    """Return what binds at the fastest prints, and the command for a print as exact as today."""
    limits, last = found.limits, found.steps[-1]
    lines = list[str]()
    for point, done in ((last.kept, ()), (last.raised, ("feed",))):
        causes = [cause for cause in _binding(point) if cause in ADVICE and cause not in done]
        for cause in causes[:1]:
            lines.append(ADVICE[cause].format(layer=limits.min_layer_time, flow=limits.flow) + ".")
    step = recommended(found)
    gain = 1.0 - step.raised.seconds / found.original.seconds
    faster = f"{100.0 * gain:.0f} % faster" if gain > 0.0 else "no faster"
    lines.append(
        f"Next, as exact as the file today and {faster}: hframe-post convert "
        f"--max-error {1e3 * step.bound:.3g}um --speed-up max"
    )
    return list(dict.fromkeys(lines))


def recommended(found: Curve) -> Step:
    """Return the step with the largest bound that no feature exceeds today, or the first."""
    today = max(found.original.errors.values())
    return [step for step in found.steps if step.bound <= 1.01 * today or step is found.steps[0]][
        -1
    ]


def _binding(point: Point) -> list[str]:
    """Return what limits the speed, the longest time first."""
    total = sum(point.limited_by.values()) or 1.0
    shares = {cause: seconds / total for cause, seconds in point.limited_by.items()}
    named = [cause for cause, share in shares.items() if share >= NAMED and cause != "travel"]
    return sorted(named, key=lambda cause: -shares[cause])


def causes(point: Point) -> str:
    """Return what limits the speed most."""
    return ", ".join(CAUSES[cause] for cause in _binding(point)[:2])


def _time(point: Point, before: float) -> str:
    change = 100.0 * (point.seconds / before - 1.0) if before else 0.0
    return f"{duration(point.seconds)} ({change:+.0f} %)"


def _errors(point: Point, name: str) -> list[str]:
    errors = point.errors
    return [_um(errors.ours, name), _um(errors.shaped, name)]


def _um(errors: dict[str, float], name: str) -> str:
    return f"{1e3 * errors[name]:.3g} µm" if name in errors else ""
