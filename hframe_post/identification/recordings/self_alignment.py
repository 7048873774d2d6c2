"""Start, clock, axis and sign of a recording, found from the motion itself.

Klipper's TEST_RESONANCES, and most other programs, play no marks and do not tell when the motion
began. What must be found:

=========  =====================================================================================
rough      pieces of the command are searched for in the recording, each by itself
clock      the same frequency is excited at several times: by the sine, by its harmonics, by slow
           motion beneath it. On the right clock all of them have one phase, so the command
           explains most of the recording (the coherence is greatest)
direction  below its resonances the printer follows its command, so the answer there points
           along the axis, whatever way the sensor is mounted
=========  =====================================================================================

What is left of the start is part of the delay that the model's fit finds.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.fft import rfft, rfftfreq
from scipy.signal import find_peaks

from hframe_post.arrays import TS, Array, Complex, Flags
from hframe_post.errors import IdentificationError
from hframe_post.identification.recordings.accelerometer import GRAVITY, Recording
from hframe_post.identification.recordings.clock_sync import (
    Resampler,
    clock_from_windows,
    moving_samples,
    not_found,
)
from hframe_post.identification.responses.frequency_response import FrequencyResponse

TAIL = 1000  # samples recorded after the command, in which the printer stops ringing
SEGMENT, HOP = 2000, 500  # samples, of the spectra that are compared over time
COHERENT = 0.8  # coherence from which a frequency counts as excited
CLOCK_BAND_HZ = (4.0, 100.0)
LATEST = 0.08  # s by which the rough start may be off
ACROSS = 0.5  # of the answer at low frequencies that may be out of phase


@dataclass(frozen=True, slots=True)
class SelfAligned:
    """A recording on the clock of its command, in the sensor's axes.

    command (m,), acceleration (m, 3): mm/s² every 1 ms, at rest at both ends. up (3,): unit vector
    along gravity's reaction, as the sensor sees it. start: s of the recording at which the
    command begins; drift: by how much the sensor's clock runs fast.
    """

    command: Array
    acceleration: Array
    up: Array
    start: float
    drift: float


@dataclass(frozen=True, slots=True)
class Direction:
    """Where the swept axis points, as the sensor sees it.

    axis (3,): unit vector. delay: s by which the answer is late, ±2 ms. resonance_hz: of the
    lowest strong resonance. excited_hz: lowest frequency from which on the command explains the
    answer.
    """

    axis: Array
    delay: float
    resonance_hz: float
    excited_hz: float


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
    if rough is None:
        rough = clock_from_windows(command, moving, sensor, False)[:2]
    start, drift = rough
    first, last = start + (1.0 + drift) * TS * moving[[0, -1]]
    if first < -0.05:
        raise IdentificationError(f"the recording begins {-first:.2f} s after the motion does")
    if last > sensor.seconds + 0.05:
        raise IdentificationError(
            f"the recording ends {last - sensor.seconds:.2f} s before the motion does"
        )
    whole = np.pad(command, (0, TAIL))
    for reach in (6e-4, 4e-5):
        drift += _drift(command, sensor.resampled(start, drift, len(command)), reach)
    acceleration = sensor.resampled(start, drift, len(whole))
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
    unexplained = []
    for drift in drifts:
        summed = np.einsum("tf,tfc->fc", np.exp(1j * turn * drift), cross)
        explained = (np.abs(summed) ** 2).sum(axis=1) / np.maximum(sent * received, 1e-300)
        unexplained.append(np.log(np.maximum(1.0 - explained, 1e-6)).sum())
    return float(drifts[np.argmin(unexplained)])


def direction(responses: list[FrequencyResponse]) -> Direction:
    """Return the axis that three responses (one for each of the sensor's axes) show.

    Raises IdentificationError if the printer does not follow the command at low frequencies.
    """
    hz = responses[0].hz
    H = np.array([one.H for one in responses])
    size = np.sqrt((np.abs(H) ** 2).sum(axis=0))
    strongest = int(np.argmax((np.abs(H) ** 2 * responses[0].power).sum(axis=1)))
    excited = _excited(responses[strongest])
    resonance = _first_resonance(hz, size, excited)
    low, low_end = hz[excited][0], max(0.7 * resonance, 2.5 * hz[excited][0])
    used = excited & (hz <= low_end)
    unit = H[:, used] / np.abs(H[strongest, used])
    delays = np.arange(-LATEST, LATEST, 2e-4)
    turned = np.exp(2j * np.pi * np.outer(hz[used], delays))
    delay = float(delays[np.argmax((np.abs(unit @ turned) ** 2).sum(axis=0))])
    along = (unit * np.exp(2j * np.pi * hz[used] * delay))[:, hz[used] <= 0.6 * low_end]
    axis = _at_rest(along, hz[used][hz[used] <= 0.6 * low_end])
    if np.linalg.norm(along.mean(axis=1).imag) > ACROSS * np.linalg.norm(along.mean(axis=1).real):
        raise not_found()
    return Direction(axis / np.linalg.norm(axis), delay, resonance, float(low))


def _excited(response: FrequencyResponse) -> Flags:
    """Flag the frequencies (k,) that lie above the last gap in the command's low end."""
    smooth = _smoothed(response.coherence, response.hz, 1.0)
    middle = response.hz <= 30.0
    gaps = np.flatnonzero((smooth < COHERENT) & middle)
    if smooth[~middle].size == 0 or np.median(smooth) < 0.25:
        raise not_found()
    first = int(gaps[-1]) + 1 if gaps.size else 0
    flags = np.zeros(len(response.hz), dtype=bool)
    flags[first:] = True
    if not flags.any():
        raise not_found()
    return flags


def _first_resonance(hz: Array, size: Array, excited: Flags) -> float:
    """Return the lowest frequency at which the answer peaks with half its greatest strength."""
    smooth = np.where(excited, _smoothed(size, hz, 3.0), 0.0)
    most = smooth.max()
    peaks, _ = find_peaks(np.append(smooth, 0.0), height=0.5 * most, prominence=0.25 * most)
    return float(hz[peaks[0]])


def _smoothed(values: Array, hz: Array, width_hz: float) -> Array:
    n = max(int(width_hz / (hz[1] - hz[0])) | 1, 1)
    padded = np.pad(values, n // 2, mode="edge")
    return np.convolve(padded, np.ones(n) / n, "valid")


def _at_rest(answer: Complex, hz: Array) -> Array:
    """Return the answer (3,) at rest by a line through (3, k) answers: racking grows with j·f."""
    columns = np.column_stack([np.ones(len(hz)), 1j * hz / hz[-1]])
    stacked = np.concatenate([columns.real, columns.imag])
    wanted = np.concatenate([answer.T.real, answer.T.imag])
    return np.asarray(np.linalg.lstsq(stacked, wanted)[0][0])
