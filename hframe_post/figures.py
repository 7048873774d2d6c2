"""Draws the figures of ``paper`` and ``tune``: PNG and SVG, by matplotlib."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hframe_post.arrays import Array, Complex
from hframe_post.errors import HframeError
from hframe_post.fit import Fit
from hframe_post.identify import Measured
from hframe_post.paper import (
    N_FIG_9,
    Approximation,
    FrequencyResponses,
    TimeResponse,
    Widths,
)
from hframe_post.printer import Motors
from hframe_post.report import STRATEGY_NAMES
from hframe_post.stream import TS
from hframe_post.tune import Trial

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLOURS = {"none": "#888888", "fbs": "#c05020", "racking": "#2060a0"}
DPI = 110
TINY = 1e-12  # magnitude that is as good as none
STYLE = {
    "font.size": 9.0,
    "axes.grid": True,
    "grid.alpha": 0.3,
    "svg.hashsalt": "hframe-post",  # equal drawings give equal files
    "svg.fonttype": "none",
    "path.simplify_threshold": 0.5,
}


def save(figure: Figure, path: Path) -> None:
    """Writes a .png or .svg without what changes from run to run."""
    volatile = ("Date", "Creator") if path.suffix == ".svg" else ("Software",)
    figure.savefig(path, dpi=DPI, metadata=dict.fromkeys(volatile))


def ready(folder: Path) -> None:
    """Makes the folder, and raises HframeError before any work if matplotlib is missing."""
    canvas(1, 1, (1.0, 1.0))
    folder.mkdir(parents=True, exist_ok=True)


def save_all(drawings: Mapping[str, Figure], folder: Path) -> None:
    """Each as PNG and SVG under its name."""
    for name, drawing in drawings.items():
        for kind in ("png", "svg"):
            save(drawing, folder / f"{name}.{kind}")


def canvas(rows: int, columns: int, size: tuple[float, float]) -> tuple[Figure, Any]:
    """A figure with its axes. Raises HframeError without matplotlib."""
    try:
        import matplotlib
        from matplotlib.figure import Figure
    except ImportError:
        raise HframeError("drawing needs matplotlib: pip install 'hframe-post[plot]'") from None
    style: Any = matplotlib.rcParams
    style.update(STYLE)
    figure = Figure(figsize=size, layout="constrained")
    return figure, figure.subplots(rows, columns, squeeze=False)


def racking_response(responses: FrequencyResponses) -> Figure:
    """Fig. 4: Gxθ."""
    figure, axes = canvas(2, 1, (5.0, 4.2))
    _bode(axes[:, 0], responses.hz, responses.Gxtheta, "rad/m", "$G_{x\\theta}$")
    return figure


def axis_responses(responses: FrequencyResponses) -> Figure:
    """Fig. 5: Gxx and Gyy."""
    figure, axes = canvas(2, 2, (8.0, 4.2))
    _bode(axes[:, 0], responses.hz, responses.Gxx, "mm/mm", "(a) $G_{xx}$")
    _bode(axes[:, 1], responses.hz, responses.Gyy, "mm/mm", "(b) $G_{yy}$")
    return figure


def identification(name: str, measured: Measured, found: Fit) -> Figure:
    """A transfer function as measured by place, together and fitted, after Fig. 4 and 5.

    Below magnitude and phase: coherence, and what the model is off, relative.
    """
    figure, axes = canvas(4, 1, (6.0, 8.0))
    axis = axes[:, 0]
    hz, mean = measured.mean.hz, measured.mean
    delay = np.exp(-2j * np.pi * hz * found.delay)
    model = found.G.response(2.0 * np.pi * TS * hz) * delay
    curves = [(response, f"x = {place:.0f} mm") for place, response in measured.places]
    for response, label in curves:
        axis[0].semilogx(hz, _decibel(response.H), lw=0.6, label=label)
        axis[1].semilogx(hz, _degrees(response.H), lw=0.6)
    axis[0].semilogx(hz, _decibel(mean.H), color="k", lw=1.0, label="together")
    axis[1].semilogx(hz, _degrees(mean.H), color="k", lw=1.0)
    axis[0].semilogx(hz, _decibel(model), "--", color=COLOURS["racking"], lw=1.5, label="model")
    axis[1].semilogx(hz, _degrees(model), "--", color=COLOURS["racking"], lw=1.5)
    axis[2].semilogx(hz, mean.coherence, color="k", lw=1.0)
    axis[3].loglog(hz, np.abs(mean.H / model - 1.0), color=COLOURS["fbs"], lw=1.0)
    unit = "rad/mm" if name == "Gxtheta" else "mm/mm"
    axis[0].set(ylabel=f"magnitude, dB ({unit})", title=name)
    axis[0].legend(fontsize=7)
    axis[1].set(ylabel="phase, °")
    axis[2].set(ylabel="coherence", ylim=(0.0, 1.05))
    axis[3].set(ylabel="model off, relative", xlabel="frequency, Hz")
    return figure


def _decibel(H: Complex) -> Array:
    decibel: Array = 20.0 * np.log10(np.maximum(np.abs(H), TINY))
    return decibel


def _degrees(H: Complex) -> Array:
    return np.degrees(np.unwrap(np.angle(H)))


def _bode(axes: Any, hz: Any, response: Any, unit: str, title: str) -> None:
    axes[0].semilogx(hz, _decibel(response), color=COLOURS["racking"])
    axes[0].set(ylabel=f"magnitude, dB ({unit})", title=title)
    axes[1].semilogx(hz, _degrees(response), color=COLOURS["racking"])
    axes[1].set(ylabel="phase, °", xlabel="frequency, Hz")


def approximation(rows: Sequence[Approximation]) -> Figure:
    """Fig. 8: contour error and time, decoupled (solid) and coupled (dashed)."""
    figure, axes = canvas(1, 2, (8.0, 3.2))
    share = [row.share for row in rows]
    for k, (name, style) in enumerate((("decoupled", "-o"), ("coupled", "--s"))):
        axes[0, 0].semilogy(share, [row.rms[k] * 1e3 for row in rows], style, label=name)
        axes[0, 1].plot(share, [row.seconds[k] for row in rows], style, label=name)
    axes[0, 0].set(xlabel="n / E", ylabel="RMS contour error, µm", title="(a)")
    axes[0, 1].set(xlabel="n / E", ylabel="time, s", title="(b)")
    axes[0, 0].legend()
    return figure


def time_response(responses: Sequence[TimeResponse]) -> Figure:
    """Fig. 9: the nozzle's path at a corner, and contour error along the path."""
    figure, axes = canvas(1, 2, (9.0, 3.4))
    for response in responses:
        x, y = (response.nozzle - response.nozzle[0]).T
        label = STRATEGY_NAMES[response.name]
        axes[0, 0].plot(x, y, color=COLOURS[response.name], lw=1.0, label=label)
        axes[0, 1].plot(response.along, response.error * 1e3, color=COLOURS[response.name], lw=1.0)
    axes[0, 0].set(xlim=(112, 122), ylim=(-1.5, 6), xlabel="x, mm", ylabel="y, mm")
    axes[0, 0].set_title(f"(a) first corner, n = {N_FIG_9}")
    axes[0, 0].legend(loc="upper left")
    axes[0, 1].set(xlabel="along the path, mm", ylabel="contour error, µm", title="(b)")
    return figure


def width_errors(widths: Sequence[Widths]) -> Figure:
    """Fig. 11: |Δw| as boxes (median in the box), its RMS as a diamond."""
    figure, axes = canvas(1, len(widths), (4.5 * len(widths), 3.4))
    for axis, prism in zip(axes[0], widths, strict=True):
        names = list(prism.error)
        boxes = [np.abs(prism.error[name]).ravel() * 1e3 for name in names]
        axis.boxplot(boxes, tick_labels=[STRATEGY_NAMES[name] for name in names])
        rms = [prism.rms(name) * 1e3 for name in names]
        axis.plot(range(1, len(names) + 1), rms, "D", color=COLOURS["racking"], label="RMS")
        axis.set(ylabel="|Δw|, µm", title=f"{prism.window} window")
        axis.tick_params(axis="x", labelsize=7)
        axis.legend()
    return figure


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
