"""Figures of an identification: what was measured, and the model."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hframe_post.arrays import TS
from hframe_post.identification.fitting.fit import Fit
from hframe_post.identification.identify import Measured
from hframe_post.identification.verification.verdict import Verdict

if TYPE_CHECKING:
    from matplotlib.figure import Figure
from hframe_post.model.strategies import STRATEGIES
from hframe_post.plotting import canvas, decibel, degrees


def identification(name: str, measured: Measured, found: Fit) -> Figure:
    """A transfer function as measured by place, together and fitted, after Fig. 4 and 5.

    Below magnitude and phase: coherence, and what the model is off, relative.
    """
    figure, axes = canvas(4, 1, (6.0, 8.0))
    axis, colour = axes[:, 0], STRATEGIES["racking"].colour
    hz, mean = measured.mean.hz, measured.mean
    delay = np.exp(-2j * np.pi * hz * found.recording_delay)
    model = found.G.response(2.0 * np.pi * TS * hz) * delay
    curves = [(response, f"x = {place:.0f} mm") for place, response in measured.places]
    for response, label in curves:
        axis[0].semilogx(hz, decibel(response.H), lw=0.6, label=label)
        axis[1].semilogx(hz, degrees(response.H), lw=0.6)
    axis[0].semilogx(hz, decibel(mean.H), color="k", lw=1.0, label="together")
    axis[1].semilogx(hz, degrees(mean.H), color="k", lw=1.0)
    axis[0].semilogx(
        hz, decibel(model), "--", color=STRATEGIES["racking"].colour, lw=1.5, label="model"
    )
    axis[1].semilogx(hz, degrees(model), "--", color=colour, lw=1.5)
    axis[2].semilogx(hz, mean.coherence, color="k", lw=1.0)
    axis[3].loglog(hz, np.abs(mean.H / model - 1.0), color=STRATEGIES["fbs"].colour, lw=1.0)
    unit = "rad/mm" if name == "Gxtheta" else "mm/mm"
    axis[0].set(ylabel=f"magnitude, dB ({unit})", title=name)
    axis[0].legend(fontsize=7)
    axis[1].set(ylabel="phase, °")
    axis[2].set(ylabel="coherence", ylim=(0.0, 1.05))
    axis[3].set(ylabel="model off, relative", xlabel="frequency, Hz")
    return figure


def verification(verdict: Verdict) -> Figure:
    """Contour error along the test motion, plain and compensated, as measured and as predicted."""
    figure, axes = canvas(2, 1, (7.0, 5.0))
    pairs = zip(("none", "racking"), verdict.errors_measured, verdict.errors_predicted, strict=True)
    for axis, (name, measured, predicted) in zip(axes[:, 0], pairs, strict=True):
        strategy = STRATEGIES[name]
        axis.plot(verdict.at, measured, color=strategy.colour, lw=0.7, label="measured")
        axis.plot(verdict.at, predicted, color="k", lw=0.5, label="predicted")
        axis.set(ylabel="contour error, µm", title=strategy.label)
        axis.legend(fontsize=7)
    axes[-1, 0].set(xlabel="time, s")
    return figure
