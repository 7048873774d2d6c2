"""The motion of `check`: the sweep in a few seconds, up to little more than the known modes.

A fast sweep excites each frequency for a shorter time but as hard. For a handful of known modes
that is enough: at 5 s an axis, a mode is found to 0.1 % with the noise of cheap sensors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from hframe_post.identification.checking.known import known_modes
from hframe_post.identification.checking.response import highest_hz
from hframe_post.identification.recordings import sweep
from hframe_post.identification.recordings.sweep import Run
from hframe_post.model.impulse_response import ImpulseResponse
from hframe_post.printer.settings import Printer

SECONDS = 4.8  # of the sine: 20 s for both axes, with the time in which the sensors are set up
QUIET = 0.5  # s; a mode of 20 Hz with damping 0.03 falls to 15 %
BEYOND = 1.4  # times the highest mode, at which the sine ends
LEAST_HZ = 60.0  # at which it ends at the least


def runs(printer: Printer, axes: Sequence[int]) -> list[Run]:
    """Return a short run for each axis (0: x, 1: y), in the middle of the travel.

    Raises HframeError.
    """
    return [_run(printer, axis) for axis in axes]


def _run(printer: Printer, axis: int) -> Run:
    settings = printer.sweep
    G = (printer.plant.Gxx, printer.plant.Gyy)[axis]
    if isinstance(G, ImpulseResponse):
        shown = highest_hz(G)
    else:
        shown = BEYOND * max(known_modes(G), default=0.0)
    end = min(max(shown, LEAST_HZ), settings.end_hz)
    rate = (end - settings.start_hz) / SECONDS
    short = replace(settings, end_hz=end, rate_hz_per_s=rate, quiet=QUIET)
    x, y = (round(sum(ends) / 2.0, 3) for ends in (printer.travel.x, printer.travel.y))
    (run,) = sweep.runs(replace(printer, sweep=short), axis, [(x, y)])
    return replace(run, name=f"check-{'xy'[axis]}")
