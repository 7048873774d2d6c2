"""Where the printer's axes lie in those of its sensor.

Below its resonances the printer follows its command, so the response there points along the axis
that moves, whatever way the sensor is mounted. No mounting is wrong: a sensor on a bed that moves
sees y the other way round, and owners mirror axes in printer.cfg, since a spectrum does not show a
sign.

What the nozzle adds to its command grows with the frequency, with a quarter turn and in phase.
Strokes excite slow motion of all axes at once, and show their directions D (k, 3) by

    a ≈ D·u + E·du/dt + F·d²u/dt² + b

A test of resonances moves along one line, and shows its delay, too. Runs in two directions with the
sensor mounted alike show where x and y point; of one direction the other lies at right angles, by
gravity.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.fft import ifft
from scipy.ndimage import median_filter
from scipy.signal import find_peaks

from hframe_post.arrays import TS, Array, Complex, Flags, X, Y
from hframe_post.errors import IdentificationError
from hframe_post.identification import verdict
from hframe_post.identification.estimation.frequency_response import FrequencyResponse
from hframe_post.identification.recordings.clock import Aligned, not_found, slow_part

EXCITED = 0.1  # of a test's usual power, from which a frequency counts as excited
LATEST_GAP_HZ = 30.0  # at which a test begins at the latest
LEAST_HZ = 8.0  # to which a test lasts at least; slow sweeping lies below
STEP = 2e-4  # s between the delays that are tried


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


def direction(responses: list[FrequencyResponse]) -> Direction:
    """Return the axis that three responses (one for each of the sensor's axes) show.

    Raises IdentificationError if the printer does not follow the command at low frequencies.
    """
    hz, power = responses[0].hz, responses[0].power
    H = np.array([one.H for one in responses])
    size = np.linalg.norm(H, axis=0)
    whole = size**2 / (np.abs(H) ** 2 / np.array([one.coherence for one in responses])).sum(axis=0)
    excited = _excited(hz, power, whole)
    resonance = _first_resonance(hz, size, excited)
    low, high = hz[excited][[0, -1]].tolist()
    low_end = max(0.7 * resonance, 2.5 * low)
    used = excited & (hz <= low_end)
    unit, weight = H[:, used] / size[used], np.clip(whole, 0.0, 1.0)[used]
    delay = _delay(unit * weight, hz[used])
    lowest = hz[used] <= 0.6 * low_end
    along = (unit * np.exp(2j * np.pi * hz[used] * delay))[:, lowest]
    axis = _at_rest(along, hz[used][lowest], weight[lowest])
    mean = along @ weight[lowest]
    if np.linalg.norm(mean.imag) > verdict.OUT_OF_PHASE * np.linalg.norm(mean.real):
        raise not_found()
    return Direction(axis / np.linalg.norm(axis), delay, resonance, (low, high))


def _delay(unit: Complex, hz: Array) -> float:
    """Return the delay in s with which directions (3, k) at hz (k,), evenly spaced, are one."""
    step = float(hz[1] - hz[0])
    n = round(1.0 / (STEP * step))
    at = np.rint(hz / step).astype(int)
    spectrum = np.zeros((3, n), dtype=complex)
    spectrum[:, at] = unit
    best = int(np.argmax((np.abs(ifft(spectrum, axis=1)) ** 2).sum(axis=0)))
    return STEP * (best - n if best > n // 2 else best)


def _excited(hz: Array, power: Array, coherence: Array) -> Flags:
    """Flag the frequencies (k,) from the last gap at the low end to where the test ended.

    A test's pulses grow with the frequency. The slow sweeping under them has lines below, too, and
    the pulses have harmonics of a ninth of their power.
    """
    coherence = _smoothed(coherence, hz, 1.0)
    middle = hz <= LATEST_GAP_HZ
    step = float(hz[1] - hz[0])
    level = power / np.square(hz)
    steady = median_filter(level, max(round(2.0 / step), 1), mode="nearest")
    usual = float(np.median(level[steady > EXCITED * steady[hz > LEAST_HZ].max(initial=0.0)]))
    inside = ~middle & (steady > EXCITED * usual)
    if not inside.any() or np.median(coherence[inside]) < verdict.COHERENCE:
        raise not_found()
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


def _at_rest(response: Complex, hz: Array, weight: Array) -> Array:
    """Return the response (3,) at rest by a line through (3, k): racking grows with j·f."""
    columns = np.column_stack([weight, 1j * weight * hz / hz[-1]])
    stacked = np.concatenate([columns.real, columns.imag])
    response = response * weight
    wanted = np.concatenate([response.T.real, response.T.imag])
    return np.asarray(np.linalg.lstsq(stacked, wanted, rcond=None)[0][0])


def slow_directions(found: Aligned) -> Array:
    """Return where the directions of a command point, as the sensor sees their slow motion, (k, 3).

    Raises IdentificationError if the recording does not show one of them.
    """
    slow, shown = slow_part(found.command), slow_part(found.acceleration)
    rates = np.gradient(slow, TS, axis=0)
    columns = np.hstack([slow, rates, np.gradient(rates, TS, axis=0)])
    D = np.linalg.lstsq(columns / columns.std(axis=0), shown, rcond=None)[0]
    D = (D / columns.std(axis=0)[:, None])[: slow.shape[1]]
    if (np.linalg.norm(D, axis=1) < verdict.SHOWN).any():
        raise not_found()
    return np.asarray(D)


def axes_in_sensor(commanded: Array, seen: Array, up: Array) -> Array:
    """Return the printer's axes as the sensor sees them: x, y and z, in rows (3, 3).

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
    x, y = np.linalg.lstsq(commanded, seen, rcond=None)[0]
    z = np.cross(x, y)
    return np.array([x, y, z / np.linalg.norm(z) * (np.sign(z @ up) or 1.0)])
