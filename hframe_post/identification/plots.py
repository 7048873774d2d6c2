"""Figures of an identification: what was measured, and the model."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hframe_post.arrays import TS
from hframe_post.identification.fit import Fit
from hframe_post.identification.identify import Measured

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
    delay = np.exp(-2j * np.pi * hz * found.delay)
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
