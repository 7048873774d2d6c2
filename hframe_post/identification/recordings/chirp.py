"""A motion whose frequency grows steadily, found in the spectrogram of a recording.

It draws a line f = slope·(t − origin), and its harmonics at 3f and 5f share the origin. Each
frequency's power is divided by its median over time: that removes stationary noise, such as fans,
and lets a printer's resonances count no more than other frequencies.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.fft import rfft, rfftfreq
from scipy.ndimage import uniform_filter1d
from scipy.signal.windows import hann

from hframe_post.arrays import TS, Array
from hframe_post.identification import verdict

FRAME, HOP = 1000, 250  # samples of a spectrum, and between spectra
LINE_HZ = (5.0, 200.0)  # frequencies in which lines are searched
SLOPES = np.geomspace(0.08, 8.0, 462)  # Hz/s
TRIPLE = 110  # slopes from one to its triple
ROW = 3  # Hz between the frequencies of the coarse search
CLEAR = 10.0  # ratio of the line's power to the median power at its frequency
NOTHING_SEEN = np.zeros((0, 2))
NEAR_HZ = 3.0  # around the line, in which its power is looked for


@dataclass(frozen=True, slots=True)
class ChirpLine:
    """A line f = slope·(t − origin), in Hz, Hz/s and s from the first sample.

    score: how far it stands out from the rest of the recording; 0.2 or less without a chirp, 2 or
    more with a whole one. seen (n, 2): times (s) and frequencies (Hz) through which it is drawn.
    first, last: frequencies between which it is clearly seen, Hz.
    """

    slope: float
    origin: float
    score: float
    seen: Array
    first: float = 0.0
    last: float = 0.0

    @property
    def clear(self) -> bool:
        """Return whether it is seen over 5 Hz at least, and stands out."""
        return self.score >= verdict.CHIRP_SCORE and self.last - self.first >= 5.0


def uniform(t: Array, a: Array) -> Array:
    """Return samples a (m, k) at rising times t (m,) in s without their mean, every 1 ms."""
    at = np.arange(t[0], t[-1], TS)
    smooth = uniform_filter1d(a, max(1, round(TS / float(np.median(np.diff(t))))), axis=0)
    a = np.column_stack([np.interp(at, t, column) for column in smooth.T])
    return np.asarray(a - a.mean(axis=0))


def find_line(a: Array) -> ChirpLine:
    """Return the brightest line in a signal (n, k), a sample every 1 ms."""
    if len(a) < 4 * FRAME:
        return ChirpLine(1.0, 0.0, 0.0, NOTHING_SEEN)
    frames = sliding_window_view(a, FRAME, axis=0)[::HOP] * hann(FRAME, sym=False)
    hz = rfftfreq(FRAME, TS)
    inside = (hz >= LINE_HZ[0]) & (hz <= LINE_HZ[1])
    hz, power = hz[inside], (np.abs(rfft(frames)) ** 2).sum(axis=1).T[inside]
    floor = 1e-9 * float(power.max()) + 1e-300
    contrast = power / np.maximum(np.median(power, axis=1, keepdims=True), floor)
    t = (np.arange(power.shape[1]) * HOP + FRAME / 2.0) * TS
    line = _brightest(hz, contrast)
    line = replace(line, origin=line.origin + t[0])
    for _ in range(2):
        line = _fitted(line, t, hz, power, contrast)
    return line


def _brightest(hz: Array, contrast: Array) -> ChirpLine:
    """Return the brightest line, its origin from the first spectrum."""
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
    return ChirpLine(float(SLOPES[k]), at * HOP * TS, score / len(hz), NOTHING_SEEN)


def _fitted(line: ChirpLine, t: Array, hz: Array, power: Array, contrast: Array) -> ChirpLine:
    """Return the line through the centres of power near it, by robust least squares."""
    near = NEAR_HZ + line.slope * HOP * TS
    centre = line.slope * (t - line.origin)
    close = np.abs(hz[:, None] - centre) < near
    share = power * close
    place = hz @ share / np.maximum(share.sum(axis=0), 1e-300)
    clear = (contrast * close).max(axis=0) > CLEAR
    fit = clear & (centre < hz[-1] - near)
    if np.count_nonzero(fit) < 8:
        return line
    slope, offset = robust_fit(np.column_stack([t, np.ones(len(t))])[fit], place[fit]).tolist()
    if not SLOPES[0] < slope < SLOPES[-1]:
        return line
    seen = np.column_stack([t, place])[fit]
    return ChirpLine(slope, -offset / slope, line.score, seen, *centre[clear][[0, -1]].tolist())


def robust_fit(columns: Array, wanted: Array) -> Array:
    """Return the coefficients (k,) of columns (n, k) that fit most of the values wanted (n,)."""
    weight = np.ones(len(wanted))
    for _ in range(20):
        fit = np.linalg.lstsq(columns * weight[:, None], wanted * weight, rcond=None)[0]
        miss = np.abs(wanted - columns @ fit)
        weight = 1.0 / np.hypot(1.0, miss / (1.5 * np.median(miss) + 1e-9))
    return np.asarray(fit)
