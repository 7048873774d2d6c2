"""Can the model be right? What it asks that no printer needs is an error, before it is printed.

A command leads the path by what the nozzle lags behind: speed times lag, and acceleration over
the square of the printer's frequency. A model that asks for much more contradicts itself.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from hframe_post.arrays import TS, X, Y
from hframe_post.errors import HframeError, PrinterError
from hframe_post.model.plant import Plant
from hframe_post.printer.settings import Limits, Printer
from hframe_post.stream.types import Samples

SLOW_HZ = 3.0  # at which lag and stiffness are read off a model
AMPLE = 2.0  # times what lag and acceleration explain that a command may be off its path,
ALWAYS = 3.0  # and mm besides
MOST_RACKING = 0.02  # rad, at the profile's limit of acceleration
MOST_ERROR = 1.0  # mm RMS of contour error, as predicted without compensation
ADVICE = "its [plant] cannot be that of this printer: sweep and identify again"


def check_model(printer: Printer) -> None:
    """Raises PrinterError where racking is beyond all gantries."""
    G, limits = printer.plant.Gxtheta, printer.limits
    if G is None:
        return
    omega = 2.0 * np.pi * SLOW_HZ
    slow = abs(complex(G.response(np.array([omega * TS]))[0]))
    angle = min(slow / omega * limits.velocity, slow / omega**2 * limits.acceleration)
    if angle > MOST_RACKING:
        raise PrinterError(
            f"by this model the gantry turns by {1e3 * angle:.0f} mrad, which none does; {ADVICE}",
            "plant.Gxtheta", printer.name,
        )  # fmt: skip


def reach(plant: Plant, limits: Limits) -> float:
    """mm by which a command may leave its path."""
    omega = 2.0 * np.pi * SLOW_HZ
    far = 0.0
    for G in (plant.Gxx, plant.Gyy):
        response = complex(G.response(np.array([omega * TS]))[0])
        lag, soft = -response.imag / omega, abs(1.0 - response.real) / omega**2
        far = max(far, abs(lag) * limits.velocity + soft * limits.acceleration)
    return ALWAYS + AMPLE * far


def within_reach(chunks: Iterable[Samples], strategy: str, most: float) -> Iterator[Samples]:
    """The stream as it is. Raises HframeError for a command more than ``most`` mm off its path."""
    for chunk in chunks:
        if len(chunk):
            command = chunk.commands[strategy]
            dx, dy = (command[:, axis] - chunk.xyze[:, axis] for axis in (X, Y))
            off2 = dx * dx + dy * dy
            if not off2.max() <= most * most:
                k = int(off2.argmax())
                raise HframeError(
                    f"line {int(chunk.line[k])}: the compensation would lead the nozzle "
                    f"{np.sqrt(off2[k]):.1f} mm off its path, and {most:.1f} mm is all that the "
                    f"model's own lag explains: {ADVICE}"
                )
        yield chunk


def check_prediction(rms: float) -> None:
    """Raises HframeError where a printer would have been unfit to print without compensation."""
    if rms > MOST_ERROR:
        raise HframeError(
            f"the model predicts {rms:.1f} mm RMS of contour error without compensation, which no "
            f"printer that prints has: {ADVICE}"
        )
