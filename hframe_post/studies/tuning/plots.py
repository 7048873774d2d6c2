"""The figure of ``tune``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from hframe_post.printer.settings import Motors
from hframe_post.studies.tuning.pareto import Pareto, Point
from hframe_post.studies.tuning.tune import Trial

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
from hframe_post.plotting import canvas


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
    """Draw contour error against time: all points, and those that none beats in both."""
    able = [point for point in pace.points if not point.trial.refused]
    quickest = min(point.trial.seconds for point in able)

    def longer(found: Sequence[Point]) -> list[float]:
        return [100.0 * (point.trial.seconds / quickest - 1.0) for point in found]

    def robust(found: Sequence[Point]) -> list[float]:
        return [point.trial.robust * 1e3 for point in found]

    axis.semilogy(longer(able), robust(able), ".", color="#bbbbbb", label="all, under model error")
    model = [point.trial.contour.rms * 1e3 for point in pace.front]
    axis.plot(longer(pace.front), model, "-o", ms=3, label="the model")
    axis.plot(longer(pace.front), robust(pace.front), "--o", ms=3, label="under model error")
    if pace.chosen is not None:
        chosen = [pace.chosen]
        axis.plot(longer(chosen), robust(chosen), "*", ms=12, color="k", label="chosen")
    axis.set(xlabel="more time than the quickest, %", ylabel="RMS contour error, µm")
    axis.set_title("acceleration, jerk, λ and L together", fontsize=8)
    axis.legend()
