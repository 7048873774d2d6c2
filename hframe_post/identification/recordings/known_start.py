"""Recordings whose start is known, on the clock of their command and along the printer's axes.

Klipper's samples have times of its print time, in which it also plays the motion. The start of a
command on that clock is

- the time in the recording's name at which the motion had ended, less the command's duration;
- without it, half a sample before the first sample, since Klipper keeps the samples from the first
  call of ACCELEROMETER_MEASURE on.

The printer's axes in those of the sensor follow from slow motion, in which the nozzle does what it
is commanded. What it adds to that grows with the frequency, in phase and with a quarter turn:

    a ≈ D·u + E·du/dt + F·d²u/dt² + b,   D (3, 2): where x and y point, as the sensor sees them

No mounting is wrong: a sensor on a bed that moves sees y the other way round, and owners mirror
axes in printer.cfg, since a spectrum does not show a sign.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import fftconvolve

from hframe_post.arrays import TS, Array, X, Y
from hframe_post.errors import IdentificationError
from hframe_post.identification.recordings.accelerometer import PLAUSIBLE, Recording, at_rest
from hframe_post.identification.recordings.alignment import acceleration
from hframe_post.identification.recordings.clock_sync import Resampler, banded, not_found

PLAYED_SD = 2e-5  # s: by how much Klipper plays a motion longer or shorter than its command
AGREED = 1e-3  # s by which the two starts may differ, beyond the time between samples
SHORTEST_STOP = 0.1  # s by which Klipper moves the print time at least, once its queue is empty
QUIET = 0.5  # s at the start of a recording in which the printer is at rest
SLOW_HZ = (2.0, 10.0)
LEAST = 0.3  # share of the command that the sensor must show in slow motion
LARGEST_LAG = 0.03  # s between a command and what the sensor shows; no printer lags more
PART, REACH = 8000, 2000  # samples of a part that must follow in time, and of its search
LEAST_LIKENESS = 0.4
MISSING = 0.5  # s at either end, in which the motion rests


@dataclass(frozen=True, slots=True)
class KnownStart:
    """When a command began: s on the clock of its recording, and the standard deviation of that."""

    at: float
    sd: float


def known_start(
    recording: Recording, samples: int, ended: float | None
) -> tuple[KnownStart, tuple[str, ...]]:
    """Return the start of a command of that many samples, and what was unusual about it.

    ended: print time in s at which the motion had ended, if the recording's name tells. Raises
    IdentificationError if nothing tells.
    """
    period = recording.period
    if not recording.started:
        if ended is None:
            raise IdentificationError(
                "nothing tells when its motion began. Let Klipper record it, by the file of "
                "'hframe-post measure'"
            )
        return KnownStart(ended - (samples - 1) * TS, PLAYED_SD), ()
    first = KnownStart(float(recording.t[0]) - period / 2.0, period / 12.0**0.5)
    if ended is None:
        return first, ()
    start = KnownStart(ended - (samples - 1) * TS, PLAYED_SD)
    off = start.at - first.at
    missed = abs(off) - period / 2.0
    if missed <= AGREED:
        return start, ()
    differ = f"the time in its name and its first sample differ by {1e3 * abs(off):.3g} ms"
    if missed <= SHORTEST_STOP:  # its time stamps wander, or the host was late
        return KnownStart(start.at, missed), (differ,)
    # another command has moved the print time after the motion; or the motion stopped, which shows
    return first, (f"{differ}: the sample counts",)


def on_command_clock(command: Array, recording: Recording, start: KnownStart) -> Array:
    """Return the acceleration (m, 3), mm/s², along the printer's axes at each row of a command.

    command (m, 2): mm every 1 ms, at rest for a second at both ends; recording: in any axes, also
    left-handed ones. Gravity and offset are removed, the sensor's gains are not. The band is that
    of the sensor: up to 250 Hz of 3200 samples a second. Raises IdentificationError if the
    recording does not follow the command in time, or does not cover it.
    """
    begin = start.at - float(recording.t[0])
    rest = at_rest(recording, QUIET)
    sensor = Resampler(recording.t, recording.a - rest)
    sensor.check_covers(begin, begin + (len(command) - 1) * TS, MISSING)
    a = sensor.resampled(begin, 0.0, len(command))
    moved = [axis for axis in (0, 1) if np.ptp(command[:, axis]) > 0.0]
    u = np.column_stack([acceleration(command[:, axis]) for axis in moved])
    slow, shown = (banded(values, SLOW_HZ) for values in (u, a))
    _check_in_time(slow, shown)
    rates = np.gradient(slow, TS, axis=0)
    columns = np.hstack([slow, rates, np.gradient(rates, TS, axis=0)])
    D = np.linalg.lstsq(columns / columns.std(axis=0), shown, rcond=None)[0]
    D = (D / columns.std(axis=0)[:, None])[: len(moved)]
    if (np.linalg.norm(D, axis=1) < LEAST).any():
        raise not_found()
    return np.asarray(a @ np.linalg.inv(completed(D, moved, rest)))


def completed(D: Array, moved: Sequence[int], rest: Array) -> Array:
    """Return the printer's axes as the sensor sees them: unit vectors x, y, z, in rows (3, 3).

    D (k, 3): where the axes that moved point, of any length; rest (3,): what the sensor shows at
    rest. Raises IdentificationError without gravity, if one axis moved.
    """
    D = D / np.linalg.norm(D, axis=1, keepdims=True)
    rows = np.zeros((3, 3))
    rows[list(moved)] = D
    strength = float(np.linalg.norm(rest))
    if len(moved) == 2:
        rows[2] = np.cross(rows[X], rows[Y])
        rows[2] *= np.sign(rows[2] @ rest) or 1.0
    elif PLAUSIBLE[0] <= strength <= PLAUSIBLE[1]:
        along = D[0]
        up = rest / strength - (along @ rest) / strength * along
        rows[2] = up / np.linalg.norm(up)
        rows[1 - moved[0]] = np.cross(rows[2], along) * (1.0 if moved[0] == X else -1.0)
    else:
        raise IdentificationError(
            f"at rest the sensor shows {strength / 1000.0:.4g} m/s² instead of gravity, so "
            "its axes are unknown. Record both axes at once"
        )
    return rows


def _check_in_time(slow: Array, shown: Array) -> None:
    """Raise IdentificationError unless each part of a recording follows its command.

    slow (m, k), shown (m, 3): slow parts of the command's acceleration and of the recording.
    """
    for first in range(0, len(slow) - PART // 2, PART):
        likeness, lag = _lag(slow, shown, first)
        if likeness < LEAST_LIKENESS:
            raise not_found()
        if abs(lag) <= LARGEST_LAG:
            continue
        if first == 0:
            raise IdentificationError(
                f"the motion begins {abs(lag):.2f} s {'after' if lag > 0.0 else 'before'} its "
                "recording shows it. Was another motion recorded, or the recording begun by hand?"
            )
        raise IdentificationError(
            f"the motion stopped for {abs(lag):.2f} s, {first * TS:.0f} s or less after it began: "
            "the queue of the firmware ran empty. Print the file from the virtual SD card, while "
            "nothing else keeps the host busy"
        )


def _lag(slow: Array, shown: Array, first: int) -> tuple[float, float]:
    """Return the likeness, 0 … 1, of a part of a recording to its command, and its lag in s."""
    part = slow[first : first + PART]
    low = max(first - REACH, 0)
    region = shown[low : first + len(part) + REACH]
    products = sum(
        fftconvolve(a, u[::-1], "valid") ** 2 / (u @ u) for u in part.T for a in region.T
    )
    best = int(np.argmax(products))
    energy = (region[best : best + len(part)] ** 2).sum()
    return float(np.sqrt(products[best] / max(energy, 1e-300))), (low + best - first) * TS
