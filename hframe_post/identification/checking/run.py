"""The run of `check`: its motion, and what a recording of it shows of a model.

The motion is the sweep in a few seconds, up to where the axis follows no more. A fast sweep excites
each frequency for a shorter time but as hard: at 5 s an axis, a resonance is found to 0.1 % with
the noise of cheap sensors.

The second mark is not fitted, but judges the fit: it is fast, like a corner, so belts that stiffen
on the long sine of a resonance do not pass as belts that drifted.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.fft import irfft, rfft, rfftfreq

from hframe_post.arrays import TS, Array, Complex
from hframe_post.errors import IdentificationError
from hframe_post.identification.recordings import sweep
from hframe_post.identification.recordings.alignment import acceleration, aligned, heading, turned
from hframe_post.identification.recordings.clock_sync import find_marks, moving_samples
from hframe_post.identification.responses.frequency_response import (
    FrequencyResponse,
    delays,
    whole_record,
)
from hframe_post.identification.responses.measured import Run
from hframe_post.model.impulse_response import ImpulseResponse
from hframe_post.printer.settings import Printer

SECONDS = 4.8  # of the sine: 20 s for both axes, with the time in which the sensors are set up
QUIET = 0.5  # s; a mode of 20 Hz with damping 0.03 falls to 15 %
LEAST_HZ, MOST_HZ = 60.0, 120.0  # between which the sine ends
LATE = np.arange(-15e-3, 15e-3, 5e-5)  # s by which a recording may begin late
SMOOTHED_HZ = 0.5  # over which a printer's response hardly changes, even at a resonance


def runs(printer: Printer, axes: Sequence[int]) -> list[sweep.SweepRun]:
    """Return a short run for each axis (0: x, 1: y), in the middle of the travel.

    Raises HframeError.
    """
    return [_run(printer, axis) for axis in axes]


def _run(printer: Printer, axis: int) -> sweep.SweepRun:
    settings = printer.sweep
    end = min(_highest_hz((printer.plant.Gxx, printer.plant.Gyy)[axis]), settings.end_hz)
    rate = (end - settings.start_hz) / SECONDS
    short = replace(settings, end_hz=end, rate_hz_per_s=rate, quiet=QUIET)
    x, y = (round(sum(ends) / 2.0, 3) for ends in (printer.travel.x, printer.travel.y))
    (run,) = sweep.runs(replace(printer, sweep=short), axis, [(x, y)])
    return replace(run, name=f"check-{'xy'[axis]}")


def _highest_hz(G: ImpulseResponse) -> float:
    """Return the frequency above which the nozzle moves less than its command, within limits."""
    hz = np.arange(LEAST_HZ, MOST_HZ, 0.1)
    return float(hz[np.abs(at_hz(G, hz)) > 1.0].max(initial=LEAST_HZ))


def at_hz(G: ImpulseResponse, hz: Array) -> Complex:
    """Return the complex frequency response at ``hz`` (k,)."""
    return np.asarray(G.response(2.0 * np.pi * TS * hz))


# ---------------------------------------------------------------------- what a recording shows


@dataclass(frozen=True, slots=True)
class Recorded:
    """A motion along an axis: G to fit, and command and response (n,), mm/s², to judge."""

    response: FrequencyResponse
    unseen: tuple[Array, Array]


def of_run(run: Run) -> Recorded:
    """Return what is before the second mark, when the sine's response has died away, and the mark.

    Raises IdentificationError.
    """
    u = acceleration(run.command[:, run.axis])
    marks = find_marks(u, moving_samples(u))
    if marks is None or run.nozzle is None:
        raise IdentificationError("not a run of 'hframe-post check --gcode'")
    one = aligned(u, run.nozzle, run.axis)
    a = turned(one.acceleration, heading(u, one.acceleration, run.axis))[:, run.axis]
    noise = float(a[: marks.first].std())
    end = marks.second
    return Recorded(whole_record(u[:end], a[:end], noise), (u[end:], a[end:]))


def scaling(part: FrequencyResponse) -> Callable[[Complex], tuple[float, float, float]]:
    """Return what finds how a sensor shows a modelled response H (k,).

    That is the gain and the delay (s) with which H is nearest to what was measured, and the share
    of that which it leaves.
    """
    turned_back = np.exp(2j * np.pi * np.outer(LATE, part.hz)) * (part.power * part.H)
    size = float(part.power @ np.abs(part.H) ** 2)

    def nearest(H: Complex) -> tuple[float, float, float]:
        cross = (turned_back @ H.conj()).real
        k = int(np.argmax(cross))
        own = float(part.power @ np.abs(H) ** 2)
        left = float(np.sqrt(max(1.0 - cross[k] ** 2 / (own * size), 0.0)))
        return float(cross[k] / own), float(LATE[k]), left

    return nearest


def left_unseen(
    old: ImpulseResponse,
    new: ImpulseResponse,
    unseen: tuple[Array, Array],
    band_hz: tuple[float, float],
) -> tuple[float, float, float]:
    """Return the shares that two models leave of a response they were not fitted to.

    The third is the share that the old one leaves of the new one's response. Both are cut off where
    the recording ends.
    """
    u, a = unseen
    n = 4 * len(u)
    U = rfft(u, n)
    modelled = [irfft(at_hz(G, rfftfreq(n, TS)) * U, n)[: len(u)] for G in (old, new)]
    H_old, H_new, measured = (whole_record(u, one, 0.0).within(band_hz) for one in (*modelled, a))
    left = scaling(measured)
    return left(H_old.H)[2], left(H_new.H)[2], scaling(H_new)(H_old.H)[2]


def explained(part: FrequencyResponse) -> Callable[[Complex], float]:
    """Return the function that tells how much modelled H (k,) explains of a response.

    It is 0 for a printer that follows its command exactly, and 1 for the response itself without
    what differs from one frequency to the next, as noise and harmonics do.
    """
    stiff: Complex = (np.sinc(part.hz * TS) ** 2).astype(complex)
    late = float(np.subtract(*delays([part, replace(part, H=stiff)])))
    in_time = part.H * np.exp(2j * np.pi * part.hz * late)
    step = float(np.median(np.diff(part.hz)))
    reach = np.arange(-3.0 * SMOOTHED_HZ, 3.0 * SMOOTHED_HZ + step, step)
    weight = np.exp(-((reach / SMOOTHED_HZ) ** 2) / 2.0)
    smooth = np.convolve(in_time * part.power, weight, "same")
    smooth = smooth / np.convolve(part.power, weight, "same")
    nearest = scaling(part)
    least = nearest(smooth * np.exp(-2j * np.pi * part.hz * late))[2] ** 2
    most = max(nearest(stiff)[2] ** 2, least + 1e-9)
    return lambda H: (most - nearest(H)[2] ** 2) / (most - least)
