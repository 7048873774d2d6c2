"""Start and clock of a recording, found from the motion itself.

Klipper's TEST_RESONANCES, and most other programs, play no marks and do not tell when the motion
began. First, pieces of the command are searched for, each by itself. Then the clock is refined:
the same frequency is excited at several times, by the sine, by its harmonics and by slow motion
beneath it, and on the right clock all of them have one phase, so that the command explains most
of the recording. What is left of the start is part of the delay that the model's fit finds.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.fft import rfft, rfftfreq

from hframe_post.arrays import TS, Array
from hframe_post.errors import IdentificationError
from hframe_post.identification.recordings.accelerometer import GRAVITY, Recording
from hframe_post.identification.recordings.clock_sync import (
    Resampler,
    clock_from_windows,
    moving_samples,
)

UNRECORDED = (
    0.25  # s of the motion's ends; Klipper of 2023 lost 0.03 s of its start, 0.08 s of its end
)
TAIL = 1000  # samples recorded after the command, in which the printer stops ringing
SEGMENT, HOP = 2000, 500  # samples, of the spectra that are compared over time
CLOCK_BAND_HZ = (4.0, 100.0)
# by which the drift may be off: a rough one that is known, one found from windows, a refined one
KNOWN_DRIFT, FOUND_DRIFT, FINE_DRIFT = 6e-4, 1.5e-3, 4e-5


@dataclass(frozen=True, slots=True)
class SelfAligned:
    """A recording on the clock of its command, in the sensor's axes.

    command (m,), acceleration (m, 3): mm/s² every 1 ms, 0 where nothing was recorded. up (3,): unit
    vector along gravity's reaction, as the sensor sees it. start: s of the recording at which the
    command begins; drift: by how much the sensor's clock runs fast.
    """

    command: Array
    acceleration: Array
    up: Array
    start: float
    drift: float


def self_aligned(
    command: Array, recording: Recording, rough: tuple[float, float] | None = None
) -> SelfAligned:
    """Return the recording on the clock of a command (m,), an acceleration in mm/s².

    rough: start (s) and drift if they are known to 20 ms over the recording. Raises
    IdentificationError if the recording does not contain the command.
    """
    moving = moving_samples(command)
    if not moving.size:
        raise IdentificationError("the command does not move")
    sensor = Resampler(recording.t, recording.a - recording.a.mean(axis=0))
    reach = KNOWN_DRIFT
    if rough is None:
        rough, reach = clock_from_windows(command, moving, sensor), FOUND_DRIFT
    start, drift = rough
    first, last = start + (1.0 + drift) * TS * moving[[0, -1]]
    sensor.check_covers(first, last, UNRECORDED)
    whole = np.pad(command, (0, TAIL))
    for within in (reach, FINE_DRIFT):
        drift += _drift(command, sensor.resampled(start, drift, len(command)), within)
    acceleration = sensor.resampled(start, drift, len(whole))
    clock = start + (1.0 + drift) * TS * np.arange(len(whole))
    recorded = (clock >= 0.0) & (clock <= sensor.seconds)
    whole, acceleration = whole * recorded, acceleration * recorded[:, None]
    up = recording.a.mean(axis=0)
    size = float(np.linalg.norm(up))
    up = up / size if 0.5 * GRAVITY < size < 1.5 * GRAVITY else np.zeros(3)
    return SelfAligned(whole, acceleration, up, start, drift)


def _drift(command: Array, acceleration: Array, reach: float) -> float:
    """Return the drift within ±reach with which the command explains most of the recording.

    Spectra of short pieces are turned in phase as a drift would delay them.
    """
    taper = np.hanning(SEGMENT)
    starts = np.arange(0, len(command) - SEGMENT + 1, HOP)
    pieces = starts[:, None] + np.arange(SEGMENT)
    hz = rfftfreq(SEGMENT, TS)
    inside = (hz >= CLOCK_BAND_HZ[0]) & (hz <= CLOCK_BAND_HZ[1])
    U = rfft(command[pieces] * taper, axis=1)[:, inside]
    pieces_a = acceleration[pieces]
    pieces_a = (pieces_a - pieces_a.mean(axis=1, keepdims=True)) * taper[:, None]
    A = rfft(pieces_a, axis=1)[:, inside]
    cross = U.conj()[:, :, None] * A  # (pieces, frequencies, 3)
    sent, received = (np.abs(U) ** 2).sum(axis=0), (np.abs(A) ** 2).sum(axis=(0, 2))
    turn = 2.0 * np.pi * np.outer((starts + SEGMENT / 2.0) * TS, hz[inside])
    drifts = np.linspace(-reach, reach, 81)
    phase, step = np.exp(1j * turn * drifts[0]), np.exp(1j * turn * (drifts[1] - drifts[0]))
    unexplained = []
    for _ in drifts:
        summed = np.einsum("tf,tfc->fc", phase, cross)
        explained = (np.abs(summed) ** 2).sum(axis=1) / np.maximum(sent * received, 1e-300)
        unexplained.append(np.log(np.maximum(1.0 - explained, 1e-6)).sum())
        phase *= step
    return float(drifts[np.argmin(unexplained)])
