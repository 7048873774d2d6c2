"""A motion whose frequency grows steadily, found in the spectrogram of a recording.

It draws a line f = slope·(t − origin), and its harmonics at 3f and 5f share the origin. Each
frequency's power is divided by its median over time: that removes stationary noise, such as fans,
and lets a printer's resonances count no more than other frequencies.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.fft import rfft, rfftfreq
from scipy.ndimage import uniform_filter1d
from scipy.signal.windows import hann

from hframe_post.arrays import TS, Array

FRAME, HOP = 1000, 250  # samples of a spectrum, and between spectra
LINE_HZ = (5.0, 200.0)  # frequencies in which lines are searched
SLOPES = np.geomspace(0.08, 8.0, 462)  # Hz/s
TRIPLE = 110  # slopes from one to its triple: of a test that was cut, the harmonic is brighter
ROW = 3  # Hz between the frequencies of the coarse search
CLEAR = 10.0  # ratio of the line's power to the median power at its frequency
NEAR_HZ = 3.0  # around the line, in which its power is looked for


@dataclass(frozen=True, slots=True)
class ChirpLine:
    """A line f = slope·(t − origin), in Hz, Hz/s and s from the first sample.

    seen (n, 2): times (s) and frequencies (Hz) through which it is drawn. first, last: frequencies
    between which it is clearly seen, Hz.
    """

    slope: float
    origin: float
    seen: Array
    first: float = 0.0
    last: float = 0.0


def uniform(t: Array, a: Array) -> Array:
    """Return samples a (m, k) at rising times t (m,) in s without their mean, every 1 ms."""
    at = np.arange(t[0], t[-1], TS)
    smooth = uniform_filter1d(a, max(1, round(TS / float(np.median(np.diff(t))))), axis=0)
    a = np.column_stack([np.interp(at, t, column) for column in smooth.T])
    return np.asarray(a - a.mean(axis=0))


def find_line(a: Array) -> ChirpLine | None:
    """Return the brightest line in a signal (n, k), a sample every 1 ms, or None if it has none."""
    if len(a) < 4 * FRAME:
        return None
    frames = sliding_window_view(a, FRAME, axis=0)[::HOP] * hann(FRAME, sym=False)
    hz = rfftfreq(FRAME, TS)
    inside = (hz >= LINE_HZ[0]) & (hz <= LINE_HZ[1])
    hz, power = hz[inside], (np.abs(rfft(frames)) ** 2).sum(axis=1).T[inside]
    floor = 1e-9 * float(power.max()) + 1e-300
    contrast = power / np.maximum(np.median(power, axis=1, keepdims=True), floor)
    t = (np.arange(power.shape[1]) * HOP + FRAME / 2.0) * TS
    slope, origin = _brightest(hz, contrast)
    line = _fitted(slope, origin + t[0], t, hz, power, contrast)
    return line and _fitted(line.slope, line.origin, t, hz, power, contrast)


def _brightest(hz: Array, contrast: Array) -> tuple[float, float]:
    """Return the slope and the origin, from the first spectrum, of the brightest line."""
    hz, bright = hz[::ROW], np.log1p(contrast[::ROW] / 3.0)
    bright -= bright.mean(axis=1, keepdims=True)
    sums, firsts = [], []
    for slope in SLOPES:
        delay = np.rint(hz / slope / (HOP * TS)).astype(np.int64)
        most, n = int(delay[-1]), bright.shape[1]
        total = np.zeros(n + most)  # for each origin, from −most to n
        for row, by in zip(bright, delay, strict=True):
            total[most - by : most - by + n] += row
        sums.append(total)
        firsts.append(-most)
    k = int(np.argmax([total.max() for total in sums]))
    score, at = float(sums[k].max()), int(np.argmax(sums[k])) + firsts[k]
    if k >= TRIPLE:  # a third harmonic has the origin of its chirp
        near = sums[k - TRIPLE][max(at - firsts[k - TRIPLE] - 4, 0) :][:9]
        if near.size and near.max() > 0.25 * score:
            k -= TRIPLE
    return float(SLOPES[k]), at * HOP * TS


def _fitted(
    slope: float, origin: float, t: Array, hz: Array, power: Array, contrast: Array
) -> ChirpLine | None:
    """Return the line through the centres of power near it, by robust least squares.

    None if it is seen less than 5 Hz far.
    """
    near = NEAR_HZ + slope * HOP * TS
    centre = slope * (t - origin)
    close = np.abs(hz[:, None] - centre) < near
    share = power * close
    place = hz @ share / np.maximum(share.sum(axis=0), 1e-300)
    clear = (contrast * close).max(axis=0) > CLEAR
    fit = clear & (centre < hz[-1] - near)
    if np.count_nonzero(fit) < 8:
        return None
    slope, offset = robust_fit(np.column_stack([t, np.ones(len(t))])[fit], place[fit]).tolist()
    first, last = centre[clear][[0, -1]].tolist()
    if not SLOPES[0] < slope < SLOPES[-1] or last - first < 5.0:
        return None
    return ChirpLine(slope, -offset / slope, np.column_stack([t, place])[fit], first, last)


def robust_fit(columns: Array, wanted: Array) -> Array:
    """Return the coefficients (k,) of columns (n, k) that fit most of the values wanted (n,)."""
    weight = np.ones(len(wanted))
    for _ in range(20):
        fit = np.linalg.lstsq(columns * weight[:, None], wanted * weight, rcond=None)[0]
        miss = np.abs(wanted - columns @ fit)
        weight = 1.0 / np.hypot(1.0, miss / (1.5 * np.median(miss) + 1e-9))
    return np.asarray(fit)
