"""The motion of a sweep along one axis, and its file.

    quiet, mark, quiet, sweep, quiet, mark, quiet

The sweep is a sine of acceleration whose frequency grows at a constant rate. The two marks are
one short chirp, equal bit by bit: the response to the second is that to the first, later, so
their distance on a sensor's clock gives that clock's rate. The window is applied to the
displacement, not to the acceleration, so position, speed and acceleration are exactly 0 at both
ends of every part.

Under the sweep lies a slow sway. A motor steps by 20 µm, and the sweep at 80 Hz moves by 20 µm:
without the sway each peak would be rounded alike, and the rounding would look like the printer's
gain. Swaying across many steps turns the rounding into noise and keeps the printer sliding.
Without the sway the gain of one run, weighted by input power over 5 to 80 Hz, was wrong by 1.5 to
2.4 %; with it by 0.4 to 0.5 %.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from hframe_post.arrays import TS, Array
from hframe_post.errors import IdentificationError
from hframe_post.identification.recordings.packed import unpacked
from hframe_post.native import digits
from hframe_post.printer.settings import Sweep

MARK_HZ = (10.0, 100.0)
SETTLED = 300  # samples more of rest after the sine, in which the response of a slow pole dies away
MARK_SAMPLES = 401
CSV_HEAD = "t,x,y"


def amplitude(sweep: Sweep, hz: Array, speed: float, room: float) -> Array:
    """Return the acceleration (k,), mm/s², that is commanded at the frequencies ``hz`` (k,).

    At low frequencies it keeps the speed (mm/s) within ``speed``, and the displacement within
    the stroke and within what the sway leaves of ``room`` (mm).
    """
    w = 2.0 * np.pi * hz
    stroke = min(sweep.stroke, room - _sway(sweep, room))
    limits = np.stack([np.full(len(hz), sweep.amplitude), w * speed, w * w * stroke])
    # a minimum of the three, but smooth
    return np.asarray((limits**-4.0).sum(axis=0) ** (-1.0 / 4.0))


def _sway(sweep: Sweep, room: float) -> float:
    return min(sweep.sway, 0.25 * room)


def trajectory(sweep: Sweep, speed: float, room: float) -> Array:
    """Return the displacement (n,), mm, every 1 ms, from rest at 0 to rest at 0.

    Differences of the samples never exceed the sweep's amplitude, its stroke plus sway, ``speed``
    (mm/s) and ``room`` (mm).
    """
    quiet = np.zeros(round(sweep.quiet / TS))
    mark = alignment_mark(sweep, speed, room)
    samples = round(sweep.seconds / TS) + 1
    sine = _chirp(sweep, sweep.start_hz, sweep.end_hz, samples, speed, room)
    # the sway is at 0.5 Hz, or below a sweep that begins lower than 2 Hz
    slow = 2.0 * np.pi * min(0.5, sweep.start_hz / 4.0) * np.arange(samples) * TS
    swaying = sine + _sway(sweep, room) * _window(samples) * np.sin(slow)
    sine = _bounded(swaying, sweep, speed, room)
    settle = np.zeros(SETTLED)
    return np.concatenate([quiet, mark, quiet, sine, settle, quiet, mark, quiet])


def alignment_mark(sweep: Sweep, speed: float, room: float) -> Array:
    """Return the short chirp, (n,) mm every 1 ms, of which two align a recording."""
    mark = _chirp(sweep, *MARK_HZ, MARK_SAMPLES, speed, room)
    return _bounded(mark, sweep, speed, room)


def peaks(displacement: Array) -> tuple[float, float, float]:
    """Return the greatest displacement (mm), speed (mm/s) and acceleration (mm/s²) of (n,)."""
    orders = [np.diff(displacement, n=order) / TS**order for order in range(3)]
    d, v, a = (float(np.abs(values).max(initial=0.0)) for values in orders)
    return d, v, a


def _chirp(
    sweep: Sweep, start_hz: float, end_hz: float, n: int, speed: float, room: float
) -> Array:
    """Return a sine from one frequency to another, (n,), mm, 0 at both ends."""
    t = np.arange(n) * TS
    rate = (end_hz - start_hz) / t[-1]
    hz = start_hz + rate * t
    size = amplitude(sweep, hz, speed, room) / np.square(2.0 * np.pi * hz)
    phase = 2.0 * np.pi * (start_hz + rate * t / 2.0) * t
    return np.asarray(_window(n) * size * np.sin(phase))


def _bounded(wave: Array, sweep: Sweep, speed: float, room: float) -> Array:
    """Return the wave (n,), scaled down if needed: windows and sway add to the sine's peaks."""
    bounds = (min(sweep.stroke + sweep.sway, room), speed, sweep.amplitude)
    share = min(1.0, *(b / p for b, p in zip(bounds, peaks(wave), strict=True) if p > 0.0))
    return np.asarray(share * wave)


def _window(n: int) -> Array:
    """Return 0 at both ends and 1 between, (n,), with continuous second derivative."""
    edge = min(500, n // 4)
    u = np.clip(np.minimum(np.arange(n), np.arange(n)[::-1]) / edge, 0.0, 1.0)
    return np.asarray(u**3 * (10.0 - u * (15.0 - 6.0 * u)))


# ---------------------------------------------------------------------- files


def command_csv(command: Array) -> Iterator[bytes]:
    """Yield a command (m, 2) as CSV: ``t,x,y`` in s and mm, one row a millisecond, t from 0."""
    yield CSV_HEAD.encode() + b"\n"
    t = np.arange(len(command)) * TS
    comma = digits.column(b",", len(command))
    at, x, y = (digits.fixed(values, 6) for values in (t, *command.T))
    yield digits.rows([at, comma, x, comma, y, digits.column(b"\n", len(command))])


def read_command(path: Path) -> Array:
    """Read x and y (m, 2) in mm from a command's CSV file.

    Raises OSError, and IdentificationError with the line and the cause.
    """
    lines = unpacked(path).decode("latin-1").splitlines()
    if not lines or lines[0].strip().lower() != CSV_HEAD:
        raise IdentificationError(
            f"{path} is not the command of a motion, whose first line is {CSV_HEAD}. Give the "
            "command first and the recording after it"
        )
    if sum(bool(line.strip()) for line in lines[1:]) < 1000:
        raise IdentificationError(f"{path}: too short for a command: at least 1000 rows are needed")
    try:
        rows = np.loadtxt(lines[1:], delimiter=",", comments=None, ndmin=2)
    except ValueError as error:
        raise IdentificationError(f"{path} cannot be read as numbers: {error}") from None
    if rows.shape[1] != 3:
        raise IdentificationError(f"{path}: rows must have three columns, {CSV_HEAD}")
    if not np.isfinite(rows).all():
        raise IdentificationError(f"{path} has values that are not finite")
    late = np.abs(rows[:, 0] - rows[0, 0] - np.arange(len(rows)) * TS) > 1e-6
    if late.any():
        raise IdentificationError(
            f"{path}: line {int(np.argmax(late)) + 2}: rows must be 1 ms apart"
        )
    return np.asarray(rows[:, 1:])
