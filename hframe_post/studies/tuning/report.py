"""The report of a tuning: tables, JSON and the figure."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from hframe_post.arrays import TS
from hframe_post.writers.stream.print_time import duration

if TYPE_CHECKING:
    from hframe_post.studies.tuning.pareto import Pareto, Point
    from hframe_post.studies.tuning.tune import StopsTrial, Trial
from typing import TYPE_CHECKING

from hframe_post.printer.settings import Motors
from hframe_post.studies.tuning.pareto import Pareto, Point
from hframe_post.studies.tuning.tune import Trial

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
from hframe_post.plotting import canvas


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


def _point_as_json(point: Point) -> dict[str, Any]:
    return {
        **point.settings,
        "seconds": round(point.trial.seconds, 3),
        **_trial_as_json(point.trial),
    }


def pace_as_json(pace: Pareto) -> dict[str, Any]:
    """Return the trials that no other beats in both time and error, the quickest first."""
    return {
        "pareto": [_point_as_json(point) for point in pace.front],
        "chosen": _point_as_json(pace.chosen) if pace.chosen else None,
    }


def pace_table(pace: Pareto) -> str:
    front, chosen = pace.front, pace.chosen
    if chosen is None:
        return ""
    quickest = front[0].trial.seconds
    lines = [
        "",
        "time against error: each is the quickest with so little error",
        f"{'':2s}{'acceleration':>13s}{'deceleration':>14s}{'jerk':>9s}{'L':>4s}"
        f"{'effort (λ)':>14s}{'time':>9s}{'µm RMS: the model':>20s}{'median':>9s}{'worst':>8s}",
    ]
    for point in front:
        (x, y), (up, down, jerk) = point.trial.windows, point.settings.values()
        longer = 100.0 * (point.trial.seconds / quickest - 1.0)
        lines.append(
            f"{'→' if point is chosen else '':2s}{up:13.0f}{down:14.0f}{jerk:9.0e}"
            f"{x.L:4d}{f'{x.effort:g}, {y.effort:g}':>14s}{f'+{longer:.1f} %':>9s}"
            f"{point.trial.contour.rms * 1e3:20.2f}{point.trial.robust * 1e3:9.2f}"
            f"{point.trial.worst * 1e3:8.2f}"
        )
    recommended = f"recommended: {_limits(chosen)}, {_settings(chosen.trial)}"
    lines += ["", recommended, _bought(pace.usual, chosen)]
    return "\n".join(lines)


def _bought(usual: Point, chosen: Point) -> str:
    """Return what the chosen limits cost and bring, compared with the profile's own."""
    before, after = usual.trial, chosen.trial
    more = after.seconds / before.seconds - 1.0
    return (
        f"compared with the profile's {_limits(usual)}: {more:+.1%} time; "
        f"median {1e3 * before.robust:.1f} → {1e3 * after.robust:.1f} µm, "
        f"worst {1e3 * before.worst:.1f} → {1e3 * after.worst:.1f} µm"
    )


def _limits(point: Point) -> str:
    return ", ".join(f"{name} = {value:g}" for name, value in point.settings.items())


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


def trials_table(trials: Sequence[Trial], best: Trial | None, advice: str) -> str:
    """Return a table of windows and efforts; advice: what the best of them is."""
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
        lines += ["", f"{advice}: {_settings(best)}"]
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


def trade_off(
    trials: Sequence[Trial], best: Trial | None, motors: Motors, pace: Pareto | None = None
) -> Figure:
    """Draw contour error against belt acceleration: the model solid, under model error dashed.

    pace: ways to plan and to compensate; their error is drawn against time in a second panel.
    """
    figure, axes = canvas(1, 2 if pace else 1, (11.0 if pace else 6.0, 4.0))
    axis = axes[0, 0]
    for k, L in enumerate(sorted({trial.windows[0].L for trial in trials})):
        row = [t for t in trials if t.windows[0].L == L and not t.refused]
        hardness = [trial.acceleration for trial in row]
        colour = f"C{k}"
        model = [t.contour.rms * 1e3 for t in row]
        axis.loglog(hardness, model, "-o", ms=3, color=colour, label=f"L = {L}")
        axis.loglog(hardness, [t.robust * 1e3 for t in row], "--", lw=1, color=colour)
    if best is not None:
        axis.plot(best.acceleration, best.robust * 1e3, "*", ms=12, color="k", label="recommended")
    axis.axvline(motors.belt_acceleration, color="#c02020", lw=1.0, label="motors' limit")
    axis.set(xlabel="peak belt acceleration, mm/s²", ylabel="RMS contour error, µm")
    axis.set_title("solid: the model; dashed: median under model error", fontsize=8)
    axis.legend()
    if pace:
        _pareto(axes[0, 1], pace)
    return figure


def _pareto(axis: Axes, pace: Pareto) -> None:
    able = [point for point in pace.points if not point.trial.refused]
    quickest = min(point.trial.seconds for point in able)

    def placed(points: Sequence[Point]) -> tuple[list[float], list[float]]:
        longer = [100.0 * (point.trial.seconds / quickest - 1.0) for point in points]
        return longer, [point.trial.robust * 1e3 for point in points]

    axis.semilogy(*placed(able), ".", color="#bbbbbb", label="all, under model error")
    model = [point.trial.contour.rms * 1e3 for point in pace.front]
    axis.plot(placed(pace.front)[0], model, "-o", ms=3, label="the model")
    axis.plot(*placed(pace.front), "--o", ms=3, label="under model error")
    if pace.chosen is not None:
        axis.plot(*placed([pace.chosen]), "*", ms=12, color="k", label="chosen")
    axis.set(xlabel="more time than the quickest, %", ylabel="RMS contour error, µm")
    axis.set_title("limits of the path, λ and L together", fontsize=8)
    axis.legend()
