"""The paper's figures, drawn."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from hframe_post.model.strategies import STRATEGIES
from hframe_post.paper.results import N_FIG_9, Approximation, FrequencyResponses, TimeResponse
from hframe_post.paper.widths import Widths

if TYPE_CHECKING:
    from matplotlib.figure import Figure
from hframe_post.plotting import canvas, decibel, degrees


def racking_response(responses: FrequencyResponses) -> Figure:
    """Draw Fig. 4: Gxθ."""
    figure, axes = canvas(2, 1, (5.0, 4.2))
    _bode(axes[:, 0], responses.hz, responses.Gxtheta, "rad/m", "$G_{x\\theta}$")
    return figure


def axis_responses(responses: FrequencyResponses) -> Figure:
    """Draw Fig. 5: Gxx and Gyy."""
    figure, axes = canvas(2, 2, (8.0, 4.2))
    _bode(axes[:, 0], responses.hz, responses.Gxx, "mm/mm", "(a) $G_{xx}$")
    _bode(axes[:, 1], responses.hz, responses.Gyy, "mm/mm", "(b) $G_{yy}$")
    return figure


def _bode(axes: Any, hz: Any, response: Any, unit: str, title: str) -> None:
    axes[0].semilogx(hz, decibel(response), color=STRATEGIES["racking"].colour)
    axes[0].set(ylabel=f"magnitude, dB ({unit})", title=title)
    axes[1].semilogx(hz, degrees(response), color=STRATEGIES["racking"].colour)
    axes[1].set(ylabel="phase, °", xlabel="frequency, Hz")


def approximation(rows: Sequence[Approximation]) -> Figure:
    """Draw Fig. 8: contour error and time, decoupled (solid) and coupled (dashed)."""
    figure, axes = canvas(1, 2, (8.0, 3.2))
    share = [row.share for row in rows]
    for k, (name, style) in enumerate((("decoupled", "-o"), ("coupled", "--s"))):
        axes[0, 0].semilogy(share, [row.rms[k] * 1e3 for row in rows], style, label=name)
        axes[0, 1].plot(share, [row.seconds[k] for row in rows], style, label=name)
    axes[0, 0].set(xlabel="n / E", ylabel="RMS contour error, µm", title="(a)")
    axes[0, 1].set(xlabel="n / E", ylabel="time, s", title="(b)")
    axes[0, 0].legend()
    return figure


def corner(responses: Sequence[TimeResponse]) -> Figure:
    """Draw the nozzle at the first corner of Fig. 7, on the desired path, for the README."""
    figure, axes = canvas(1, 1, (7.0, 3.6))
    axis = axes[0, 0]
    path = responses[0].path - responses[0].path[0]
    axis.plot(*path.T, color="#e0dccf", lw=7.0, solid_capstyle="round", label="the path")
    for response in responses:
        shown = STRATEGIES[response.name]
        label = f"{shown.label}: {response.rms * 1e3:.0f} µm RMS"
        nozzle = response.nozzle - response.nozzle[0]
        axis.plot(*nozzle.T, color=shown.colour, lw=1.6, label=label)
    axis.set(xlim=(112.5, 121.6), ylim=(-0.9, 3.3), xlabel="x, mm", ylabel="y, mm", aspect="equal")
    axis.set_title(
        "the nozzle at a corner, to the right and then up, 150 mm/s, simulated", loc="left"
    )
    axis.legend(loc="upper left")
    return figure


def time_response(responses: Sequence[TimeResponse]) -> Figure:
    """Draw Fig. 9: the nozzle's path at a corner, and contour error along the path."""
    figure, axes = canvas(1, 2, (9.0, 3.4))
    for response in responses:
        shown, nozzle = STRATEGIES[response.name], response.nozzle - response.nozzle[0]
        axes[0, 0].plot(*nozzle.T, color=shown.colour, lw=1.0, label=shown.label)
        axes[0, 1].plot(response.along, response.error * 1e3, color=shown.colour, lw=1.0)
    axes[0, 0].set(xlim=(112, 122), ylim=(-1.5, 6), xlabel="x, mm", ylabel="y, mm")
    axes[0, 0].set_title(f"(a) first corner, n = {N_FIG_9}")
    axes[0, 0].legend(loc="upper left")
    axes[0, 1].set(xlabel="along the path, mm", ylabel="contour error, µm", title="(b)")
    return figure


def width_errors(widths: Sequence[Widths]) -> Figure:
    """Draw Fig. 11: |Δw| as boxes (median in the box), its RMS as a diamond."""
    figure, axes = canvas(1, len(widths), (4.5 * len(widths), 3.4))
    for axis, prism in zip(axes[0], widths, strict=True):
        names = list(prism.error)
        boxes = [np.abs(prism.error[name]).ravel() * 1e3 for name in names]
        axis.boxplot(boxes, tick_labels=[STRATEGIES[name].label for name in names])
        rms = [prism.rms(name) * 1e3 for name in names]
        colour = STRATEGIES["racking"].colour
        axis.plot(range(1, len(names) + 1), rms, "D", color=colour, label="RMS")
        axis.set(ylabel="|Δw|, µm", title=f"{prism.window} window")
        axis.tick_params(axis="x", labelsize=7)
        axis.legend()
    return figure
