"""Where the printer's axes lie in those of its sensor.

Below its resonances the printer follows its command, so the response there points along the axis
that moves, whatever way the sensor is mounted. No mounting is wrong: a sensor on a bed that moves
sees y the other way round, and owners mirror axes in printer.cfg, since a spectrum does not show a
sign.

What the nozzle adds to its command grows with the frequency, with a quarter turn and in phase. So
slow motion shows the directions D (k, 3) of what moves by

    a ≈ D·u + E·du/dt + F·d²u/dt²

Strokes move all axes at once. A test of resonances moves along one line, and shows its delay, too.
Runs in two directions with the sensor mounted alike show where x and y point; of one direction the
other lies at right angles, by gravity.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.fft import ifft
from scipy.ndimage import median_filter
from scipy.signal import find_peaks

from hframe_post.arrays import TS, Array, Complex, Flags, X, Y
from hframe_post.errors import IdentificationError
from hframe_post.identification.estimation.frequency_response import FrequencyResponse
from hframe_post.identification.recordings.clock import (
    SLOW_HZ,
    Aligned,
    slow_part,
)

EXCITED = 0.1  # of a test's usual power, from which a frequency counts as excited
LATEST_GAP_HZ = 30.0  # at which a test begins at the latest


@dataclass(frozen=True, slots=True)
class Direction:
    """Where the swept axis points, as the sensor sees it.

    axis (3,): unit vector. delay: s by which the response is late, ±2 ms. resonance_hz: of the
    lowest strong resonance. excited_hz: lowest and highest frequency at which the command explains
    the response.
    """

    axis: Array
    delay: float
    resonance_hz: float
    excited_hz: tuple[float, float]


def direction(found: Aligned, responses: list[FrequencyResponse]) -> Direction:
    """Return the axis that a test shows, by three responses, one for each of the sensor's axes.

    Raises IdentificationError if the command excites too little.
    """
    hz, power = responses[0].hz, responses[0].power
    H = np.array([one.H for one in responses])
    size = np.linalg.norm(H, axis=0)
    whole = size**2 / (np.abs(H) ** 2 / np.array([one.coherence for one in responses])).sum(axis=0)
    excited = _excited(hz, power)
    resonance = _first_resonance(hz, size, excited)
    low, high = hz[excited][[0, -1]].tolist()
    below = max(0.7 * resonance, 2.5 * low)
    used = excited & (hz <= below)
    delay = _delay(H[:, used] / size[used] * np.clip(whole[used], 0.0, 1.0), hz[used])
    (axis,) = slow_directions(found, (low, 0.6 * below))
    return Direction(axis / np.linalg.norm(axis), delay, resonance, (low, high))


def _delay(unit: Complex, hz: Array) -> float:
    """Return the delay in s with which directions (3, k) at hz (k,), evenly spaced, are one."""
    step, tried = float(hz[1] - hz[0]), 2e-4  # Hz; s between the delays that are tried
    n = round(1.0 / (tried * step))
    at = np.rint(hz / step).astype(int)
    spectrum = np.zeros((3, n), dtype=complex)
    spectrum[:, at] = unit
    best = int(np.argmax((np.abs(ifft(spectrum, axis=1)) ** 2).sum(axis=0)))
    return tried * (best - n if best > n // 2 else best)


def _excited(hz: Array, power: Array) -> Flags:
    """Flag the frequencies (k,) from the last gap at the low end to where the test ended.

    A test's pulses grow with the frequency. The slow sweeping under them has lines below, too, and
    the pulses have harmonics of a ninth of their power.
    """
    middle = hz <= LATEST_GAP_HZ
    step = float(hz[1] - hz[0])
    level = power / np.square(hz)
    steady = median_filter(level, max(round(2.0 / step), 1), mode="nearest")
    usual = float(np.median(level[steady > EXCITED * steady[~middle].max(initial=0.0)]))
    inside = ~middle & (steady > EXCITED * usual)
    if not inside.any():
        raise IdentificationError(f"the motion excites nothing above {LATEST_GAP_HZ:g} Hz")
    gaps = np.flatnonzero(middle & (steady < EXCITED * usual))
    flags = np.zeros(len(hz), dtype=bool)
    ends = slice(int(gaps[-1]) + 1 if gaps.size else 0, int(np.flatnonzero(inside)[-1]) + 1)
    flags[ends] = True
    return flags


def _first_resonance(hz: Array, size: Array, excited: Flags) -> float:
    """Return the lowest frequency at which the response has a clear peak.

    A peak far below the strongest one counts if it is half as high: a frame that rocks is not.
    """
    smooth = _smoothed(size, hz, 2.0)[excited]
    octave = hz[excited] < 2.0 * hz[excited][0]
    clear = max(0.1 * float(smooth.max()), 0.3 * float(np.median(smooth[octave])))
    peaks, _ = find_peaks(np.append(smooth, 0.0), prominence=clear)
    if not peaks.size:  # a stiff printer: what rings lies far above what was excited
        return 3.0 * float(hz[-1])
    high = smooth[peaks]
    at = hz[excited][peaks]
    return float(at[(at > at[np.argmax(high)] / 3.0) | (high > 0.5 * high.max())][0])


def _smoothed(values: Array, hz: Array, width_hz: float) -> Array:
    n = max(int(width_hz / (hz[1] - hz[0])) | 1, 1)
    padded = np.pad(values, n // 2, mode="edge")
    return np.convolve(padded, np.ones(n) / n, "valid")


def slow_directions(found: Aligned, band_hz: tuple[float, float] = SLOW_HZ) -> Array:
    """Return where the directions of a command point, as the sensor sees their slow motion, (k, 3).

    band_hz: of that motion.
    """
    slow, shown = slow_part(found.command, band_hz), slow_part(found.acceleration, band_hz)
    rates = np.gradient(slow, TS, axis=0)
    columns = np.hstack([slow, rates, np.gradient(rates, TS, axis=0)])
    size = columns.std(axis=0)
    D = np.linalg.lstsq(columns / size, shown, rcond=None)[0] / size[:, None]
    return np.asarray(D[: slow.shape[1]])


def axes_in_sensor(commanded: Array, seen: Array, up: Array) -> Array:
    """Return what shows the printer's x and y, (3, 2), in what the sensor shows, (n, 3).

    They stand at right angles, turned and mirrored so that they explain most of what was seen
    (Schönemann, Psychometrika 31, 1966). What lines differ by beyond that is noise, and no gain.
    commanded (k, 2): directions in x and y that moved; seen (k, 3): where the sensor saw them, of
    any length. up: as of ``Recording``, needed if all moved along one line; raises
    IdentificationError without it.
    """
    seen = seen / np.linalg.norm(seen, axis=1, keepdims=True)
    if np.linalg.matrix_rank(commanded, tol=0.3) < 2:
        if not up.any():
            raise IdentificationError(
                "the recording does not show gravity, and nothing else shows where the other axis "
                "points. Record both axes with the sensor mounted alike"
            )
        across = np.cross(up, seen[0])
        commanded = np.vstack([commanded, [-commanded[0, Y], commanded[0, X]]])
        seen = np.vstack([seen, across / np.linalg.norm(across)])
    U, _, V = np.linalg.svd(seen.T @ commanded, full_matrices=False)
    return np.asarray(U @ V)
