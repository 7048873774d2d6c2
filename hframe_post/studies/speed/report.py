"""What is told of a print that was made as fast as its error allows: text and JSON."""

from __future__ import annotations

from typing import Any

from hframe_post.studies.speed.search import Fastest
from hframe_post.writers.stream.print_time import duration

MEASURES = {"rms": "RMS", "p95": "at 95 %", "peak": "at most"}
CAUSES = {
    "file": "what keeps the file's speeds",
    "cooling": "least time of a layer",
    "travel": "travel",
    "flow": "the hot end",
    "extruder": "the extruder",
    "feed": "feed rates",
    "motors": "the motors",
    "error": "the error allowed",
}
NOTHING = 1e-5  # mm; straight lines at one speed, such as those that prime
VISIBLE = ("outer-wall", "inner-wall", "skin", "infill", "support", "other")  # the first first
HARDLY = 0.01  # of the time; a cause of less is not told


def speed_as_json(found: Fastest) -> dict[str, Any]:
    """Everything, ready for ``json.dumps``."""
    trial, original = found.trial, found.original
    return {
        "print_time_s": {
            "before": round(original.seconds, 3), "after": round(trial.seconds, 3),
        },
        "measure": found.bound.measure,
        "jerk": trial.driven.jerk,
        "corner": trial.driven.corner,
        "travel": trial.driven.travel,
        "features": {
            name: {
                "bound_um": round(found.bound.of(name) * 1e3, 4),
                "predicted_um": round(errors[0] * 1e3, 4),
                "under_model_error_um": round(max(errors) * 1e3, 4),
                "uncompensated_um": round(original.errors.get(name, 0.0) * 1e3, 4),
                "acceleration": round(trial.driven.acceleration[name], 1),
                "feed": round(trial.driven.feed[name], 3),
            }
            for name, errors in trial.errors.items()
        },
        "held_by_s": {cause: round(seconds, 3) for cause, seconds in trial.held_by.items()},
    }  # fmt: skip


def speed_as_text(found: Fastest) -> str:
    """A few lines for a person."""
    trial, original = found.trial, found.original
    change = 100.0 * (trial.seconds / original.seconds - 1.0) if original.seconds else 0.0
    measure = MEASURES[found.bound.measure]
    lines = [
        f"faster      {duration(trial.seconds)} instead of {duration(original.seconds)} "
        f"({change:+.0f} %){_promised(found, measure)}"
    ]
    for name, errors in sorted(trial.errors.items()):
        if errors[0] < NOTHING:
            continue
        um, worse = errors[0] * 1e3, max(errors) * 1e3
        before = original.errors.get(name, 0.0) * 1e3
        feed = trial.driven.feed[name]
        slower = f"; at {100.0 * feed:.0f} % of the file's feed" if feed < 1.0 else ""
        lines.append(
            f"within      {name} {um:.0f} µm {measure}, {worse:.0f} if the "
            f"model is off; {found.bound.of(name) * 1e3:.0f} allowed; {before:.0f} as the file "
            f"has it, uncompensated{slower}"
        )
    total = sum(trial.held_by.values()) or 1.0
    held = [
        f"{CAUSES[cause]} {100.0 * seconds / total:.0f} %"
        for cause, seconds in sorted(trial.held_by.items(), key=lambda item: -item[1])
        if seconds > HARDLY * total
    ]
    lines.append(f"held by     {', '.join(held)} of the time")
    return "\n".join(lines)


def _promised(found: Fastest, measure: str) -> str:
    """What the most visible kind of feature is within, and would be without compensation."""
    name = next((name for name in VISIBLE if found.trial.errors.get(name)), None)
    if name is None:
        return ""
    worse = max(found.trial.errors[name]) * 1e3
    before = found.original.errors.get(name, 0.0) * 1e3
    return (
        f", {name} within {worse:.0f} µm ({measure}), model error included; "
        f"uncompensated it would be {before:.0f} µm"
    )
