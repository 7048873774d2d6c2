"""The trade-off of ``tune``, drawn."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from hframe_post.printer.settings import Motors
from hframe_post.studies.tuning import Trial

if TYPE_CHECKING:
    from matplotlib.figure import Figure
from hframe_post.plotting import canvas


def trade_off(trials: Sequence[Trial], best: Trial | None, motors: Motors) -> Figure:
    """Contour error against peak belt acceleration: the model solid, under model error dashed."""
    figure, axes = canvas(1, 1, (6.0, 4.0))
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
    return figure
