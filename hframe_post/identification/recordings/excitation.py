"""A motion along one axis from which its transfer function can be measured.

    quiet, mark, quiet, own mark, sweep, quiet, mark, quiet

The own mark is a rest that tells the run's place (`place_mark`).

The sweep is a sine of acceleration whose frequency grows at a constant rate. The two marks are
one short chirp, equal bit by bit: the response to the second is that to the first, later, so
their distance on a sensor's clock tells how fast that clock runs. A displacement, not an
acceleration, is what is windowed, so position, speed and acceleration are 0 at both ends of
every part, with no residue.

Under the sweep lies a slow sway. A motor steps by 20 µm, the sweep at 80 Hz moves by 20 µm: at
rest on one place each peak would be rounded alike, and the rounding would pass for the
printer's gain. Swaying across many steps turns it into noise (and keeps the printer sliding).
From the default sweep to the steps of 20.6 µm that the Klipper host makes of it, over 5 to
80 Hz and weighted by input power, the gain of one run came out wrong by 1.5 to 2.4 % without
the sway and by 0.4 to 0.5 % with it; that of five places together by 0.6 and 0.25 %.
"""

from __future__ import annotations

import numpy as np

from hframe_post.arrays import TS, Array
from hframe_post.printer.settings import Sweep

LONGEST_REST = 300  # samples of an own mark: what is less comes after the sweep
MARK_HZ = (10.0, 100.0)
MARK_SAMPLES = 401  # 0.4 s
RAMP = 500  # samples over which the sweep fades in and out, or a quarter of a short one
SHARPNESS = 4.0  # of the passage from one limit to the next; finite, so that it is smooth
SWAY_HZ = 0.5  # or a quarter of the lowest frequency of a sweep that begins below 2 Hz
SWAY_SHARE = 0.25  # of the room to move, at most


def amplitude(sweep: Sweep, hz: Array, speed: float, room: float) -> Array:
    """Acceleration (k,), mm/s², that the frequencies ``hz`` (k,) are given.

    At low ones it is what leaves the speed (mm/s) within ``speed`` and the displacement within
    the stroke and what the sway leaves of ``room`` (mm).
    """
    w = 2.0 * np.pi * hz
    stroke = min(sweep.stroke, room - _swayed(sweep, room))
    limits = np.stack([np.full(len(hz), sweep.amplitude), w * speed, w * w * stroke])
    return np.asarray((limits**-SHARPNESS).sum(axis=0) ** (-1.0 / SHARPNESS))


def _swayed(sweep: Sweep, room: float) -> float:
    return min(sweep.sway, SWAY_SHARE * room)


def trajectory(sweep: Sweep, speed: float, room: float, rest: int = 0) -> Array:
    """Displacement (n,), mm, every 1 ms, from rest at 0 to rest at 0.

    Never beyond the sweep's amplitude and its stroke and sway, nor beyond ``speed`` (mm/s) and
    ``room`` (mm), as differences of the samples tell. rest: samples of its own mark.
    """
    bounds = (min(sweep.stroke + sweep.sway, room), speed, sweep.amplitude)
    quiet = np.zeros(round(sweep.quiet / TS))
    mark = alignment_mark(sweep, speed, room)
    samples = round(sweep.seconds / TS) + 1
    sine = _chirp(sweep, sweep.start_hz, sweep.end_hz, samples, speed, room)
    slow = 2.0 * np.pi * min(SWAY_HZ, sweep.start_hz / 4.0) * np.arange(samples) * TS
    sine = _bounded(sine + _swayed(sweep, room) * _window(samples) * np.sin(slow), bounds)
    before, after = np.zeros(rest), np.zeros(LONGEST_REST - rest)
    return np.concatenate([quiet, mark, quiet, before, sine, after, quiet, mark, quiet])


def alignment_mark(sweep: Sweep, speed: float, room: float) -> Array:
    """The short chirp, (n,) mm every 1 ms, by two of which a recording is aligned."""
    bounds = (min(sweep.stroke + sweep.sway, room), speed, sweep.amplitude)
    return _bounded(_chirp(sweep, *MARK_HZ, MARK_SAMPLES, speed, room), bounds)


def peaks(displacement: Array) -> tuple[float, float, float]:
    """Greatest displacement (mm), speed (mm/s) and acceleration (mm/s²) of samples (n,)."""
    orders = [np.diff(displacement, n=order) / TS**order for order in range(3)]
    d, v, a = (float(np.abs(values).max(initial=0.0)) for values in orders)
    return d, v, a


def _chirp(
    sweep: Sweep, start_hz: float, end_hz: float, n: int, speed: float, room: float
) -> Array:
    """A sine from one frequency to another, (n,), mm, 0 at both ends."""
    t = np.arange(n) * TS
    rate = (end_hz - start_hz) / t[-1]
    hz = start_hz + rate * t
    given = amplitude(sweep, hz, speed, room) / np.square(2.0 * np.pi * hz)
    phase = 2.0 * np.pi * (start_hz + rate * t / 2.0) * t
    return np.asarray(_window(n) * given * np.sin(phase))


def _bounded(wave: Array, bounds: tuple[float, float, float]) -> Array:
    """The wave (n,), smaller if need be: changing amplitudes and the sway add to the sine's."""
    share = min(1.0, *(b / p for b, p in zip(bounds, peaks(wave), strict=True) if p > 0.0))
    return np.asarray(share * wave)


def _window(n: int) -> Array:
    """0 at both ends, 1 between, (n,), with continuous second derivative."""
    edge = min(RAMP, n // 4)
    u = np.clip(np.minimum(np.arange(n), np.arange(n)[::-1]) / edge, 0.0, 1.0)
    return np.asarray(u**3 * (10.0 - u * (15.0 - 6.0 * u)))
