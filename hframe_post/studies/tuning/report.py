"""The report of a tuning: tables and JSON."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from hframe_post.arrays import TS
from hframe_post.writers.print_time import duration

if TYPE_CHECKING:
    from hframe_post.studies.tuning.tune import StopsTrial, Trial


def _trial_as_json(trial: Trial) -> dict[str, Any]:
    x, y = trial.windows
    values: dict[str, Any] = {
        "L": x.L, "n_C": x.n_C, "n_up": x.n_up, "effort": [x.effort, y.effort],
    }  # fmt: skip
    if trial.refused:
        return values | {"refused": trial.refused}
    return values | {
        "contour_error_um": trial.contour.micrometres(),
        "median_under_model_error_um": round(trial.robust * 1e3, 4),
        "worst_under_model_error_um": round(trial.worst * 1e3, 4),
        "peak_belt_speed": round(trial.velocity, 3),
        "peak_belt_acceleration": round(trial.acceleration, 1),
    }


def stops_as_json(trial: StopsTrial) -> dict[str, Any]:
    seconds = {"before": trial.samples - trial.resting, "after": trial.samples}
    return {
        "stops": trial.name,
        "print_time_s": {name: round(n * TS, 3) for name, n in seconds.items()},
        "contour_error_um": trial.contour.micrometres(),
    }


def _settings(trial: Trial) -> str:
    x, y = trial.windows
    return f"L = {x.L}, n_C = {x.n_C}, n_up = {x.n_up}, effort = [{x.effort:g}, {y.effort:g}]"


def summary(
    trials: Sequence[Trial], best: Trial | None, model_error: float, draws: int,
    stops: Sequence[StopsTrial] = (),
) -> dict[str, Any]:  # fmt: skip
    """Return all trials, ready for ``json.dumps``."""
    return {
        "model_error": model_error if draws else 0.0,
        "draws": draws,
        "trials": [_trial_as_json(trial) for trial in trials],
        "recommended": _trial_as_json(best) if best else None,
        "stops": [stops_as_json(trial) for trial in stops],
    }


def trials_table(trials: Sequence[Trial], best: Trial | None) -> str:
    """Return a table of windows and efforts."""
    lines = [
        f"{'':2s}{'':3s}{'effort (λ)':>16s}{'contour error, µm RMS':>29s}{'belts, at most':>21s}",
        f"{'':2s}{'L':>3s}{'x, y':>16s}{'the model':>12s}{'median':>9s}{'worst':>8s}{'mm/s':>10s}"
        f"{'mm/s²':>11s}",
    ]
    for trial in trials:
        x, y = trial.windows
        row = f"{'→' if trial is best else '':2s}{x.L:3d}{f'{x.effort:g}, {y.effort:g}':>16s}"
        if trial.refused:
            lines.append(f"{row}  refused: {trial.refused.partition(' with ')[0]}")
        else:
            lines.append(
                f"{row}{trial.contour.rms * 1e3:12.2f}{trial.robust * 1e3:9.2f}"
                f"{trial.worst * 1e3:8.2f}{trial.velocity:10.0f}{trial.acceleration:11.0f}"
            )
    drawn = max((len(trial.drawn) for trial in trials), default=0)
    if drawn:
        lines.append(f"median and worst: of {drawn} random printers")
    elif any(trial.contour.range is not None for trial in trials):
        lines.append("median and worst: of nine of ten prints, as the printer changes")
    if best is not None:
        lines += ["", f"recommended: {_settings(best)}"]
    return "\n".join(lines)


def stops_table(stops: Sequence[StopsTrial], chosen: str) -> str:
    """Return a table of ``compensation.stops`` with time and error; ``chosen`` is the profile's."""
    lines = [f"{'':2s}{'stops':8s}{'print time':>12s}{'more':>9s}{'contour error, µm RMS':>24s}"
             f"{'95 %':>8s}{'peak':>8s}"]  # fmt: skip
    for trial in stops:
        um, seconds = trial.contour.micrometres(), trial.samples * TS
        more = trial.resting / max(trial.samples - trial.resting, 1)
        lines.append(
            f"{'→' if trial.name == chosen else '':2s}{trial.name:8s}{duration(seconds):>12s}"
            f"{more:>+9.1%}{um['rms']:24.1f}{um['p95']:8.1f}{um['peak']:8.0f}"
        )
    lines.append(
        "fast is the default: exact is visibly better on few prints and takes more time on all of "
        "them"
    )
    return "\n".join(lines)
