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

from hframe_post.arrays import Array
from hframe_post.identification import verdict

RATE = 500.0  # samples a second of a recording that is searched
FRAME, HOP = 1.0, 0.25  # s of a spectrum, and between spectra
LINE_HZ = (5.0, 200.0)  # frequencies in which lines are searched
SLOPES = (0.08, 8.0)  # Hz/s
TRIPLE = 110  # slopes from one to its triple
ROW = 3.0  # Hz between the frequencies of the coarse search
CLEAR = 10.0  # ratio of the line's power to the median power at its frequency
NEAR = 3.0  # Hz around the line in which its power is looked for
LOWEST_CENTRE = 8.0  # Hz; below it sweeping disturbs the line
LEAST_ROWS = 8  # spectra through which a line is drawn
CHIRP = 0.25  # score of a chirp, relative to that of its third harmonic, is more than this


@dataclass(frozen=True, slots=True)
class ChirpLine:
    """A line f = slope·(t − origin), in Hz, Hz/s and s from the first sample.

    first, last: frequencies between which it is clearly seen, Hz. score: how far it stands out
    from the rest of the recording; 0.2 or less without a chirp, 2 or more with a whole one. seen
    (n, 2): times (s) and frequencies through which it is drawn.
    """

    slope: float
    origin: float
    first: float
    last: float
    score: float
    seen: Array

    @property
    def clear(self) -> bool:
        """Return whether it is seen over 5 Hz at least, and stands out."""
        return self.score >= verdict.CHIRP_SCORE and self.last - self.first >= 5.0


def uniform(t: Array, a: Array) -> Array:
    """Return samples a (m, k) at rising times t (m,) in s without their mean, at ``RATE``."""
    t = t - t[0]
    at = np.arange(int(t[-1] * RATE)) / RATE
    smooth = uniform_filter1d(a, max(1, round(1.0 / RATE / float(np.median(np.diff(t))))), axis=0)
    a = np.column_stack([np.interp(at, t, column) for column in smooth.T])
    return np.asarray(a - a.mean(axis=0))


def find_line(a: Array) -> ChirpLine:
    """Return the brightest line in a signal (n, k) with ``RATE`` samples a second."""
    size, hop = round(FRAME * RATE), round(HOP * RATE)
    if len(a) < 4 * size:
        return ChirpLine(1.0, 0.0, 0.0, 0.0, 0.0, np.zeros((0, 2)))
    frames = sliding_window_view(a, size, axis=0)[::hop] * hann(size, sym=False)
    power = (np.abs(rfft(frames, axis=-1)) ** 2).sum(axis=1).T
    hz = rfftfreq(size, 1.0 / RATE)
    inside = (hz >= LINE_HZ[0]) & (hz <= LINE_HZ[1])
    hz, power = hz[inside], power[inside]
    floor = 1e-9 * float(power.max()) + 1e-300
    contrast = power / np.maximum(np.median(power, axis=1, keepdims=True), floor)
    score, slope, origin = _brightest(hz, contrast)
    t = (np.arange(power.shape[1]) * hop + size / 2.0) / RATE
    origin += t[0]
    line = ChirpLine(slope, origin, 0.0, 0.0, score, np.zeros((0, 2)))
    for _ in range(2):
        line = _fitted(line, t, hz, power, contrast)
    return line


def _brightest(hz: Array, contrast: Array) -> tuple[float, float, float]:
    """Return score, slope and origin (s from the first spectrum) of the brightest line."""
    rows = slice(0, None, max(1, round(ROW / (hz[1] - hz[0]))))
    hz, bright = hz[rows], np.log1p(contrast[rows] / 3.0)
    bright -= bright.mean(axis=1, keepdims=True)
    factors = np.exp(np.arange(0.0, np.log(SLOPES[1] / SLOPES[0]), np.log(3.0) / TRIPLE))
    sums, firsts = [], []
    for slope in SLOPES[0] * factors:
        delay = np.rint(hz / slope / HOP).astype(np.int64)
        most, n = int(delay[-1]), bright.shape[1]
        total = np.zeros(n + most)  # for each origin, from −most to n
        for row, by in zip(bright, delay, strict=True):
            total[most - by : most - by + n] += row
        sums.append(total)
        firsts.append(-most)
    at = [int(np.argmax(total)) for total in sums]
    k = int(np.argmax([total[i] for total, i in zip(sums, at, strict=True)]))
    score, origin = float(sums[k][at[k]]), at[k] + firsts[k]
    if k >= TRIPLE:  # a third harmonic has the origin of its chirp
        near = sums[k - TRIPLE][max(origin - firsts[k - TRIPLE] - 4, 0) :][:9]
        if near.size and near.max() > CHIRP * score:
            k -= TRIPLE
    return score / len(hz), float(SLOPES[0] * factors[k]), origin * HOP


def _fitted(line: ChirpLine, t: Array, hz: Array, power: Array, contrast: Array) -> ChirpLine:
    """Return the line through the centres of power near it, by robust least squares."""
    near = NEAR + line.slope * HOP
    seen = []
    for k, centre in enumerate(line.slope * (t - line.origin)):
        if hz[0] <= centre <= hz[-1]:
            low, high = np.searchsorted(hz, (centre - near, centre + near))
            share = power[low:high, k]
            place = float((share * hz[low:high]).sum() / max(float(share.sum()), 1e-300))
            seen.append((t[k], place, centre, float(contrast[low:high, k].max())))
    clear = np.array([row for row in seen if row[3] > CLEAR])
    if len(clear) < LEAST_ROWS:
        return line
    fit = clear[
        (clear[:, 2] > min(LOWEST_CENTRE, clear[-1, 2] / 2.0)) & (clear[:, 2] < hz[-1] - near)
    ]
    if len(fit) < LEAST_ROWS:
        return line
    columns = np.column_stack([fit[:, 0], np.ones(len(fit))])
    slope, offset = robust_fit(columns, fit[:, 1])
    if not SLOPES[0] < slope < SLOPES[1]:
        return line
    first, last = (float(f) for f in clear[[0, -1], 2])
    return ChirpLine(float(slope), float(-offset / slope), first, last, line.score, fit[:, :2])


def robust_fit(columns: Array, wanted: Array) -> Array:
    """Return the coefficients (k,) of columns (n, k) that fit most of the values wanted (n,)."""
    weight = np.ones(len(wanted))
    for _ in range(20):
        fit = np.linalg.lstsq(columns * weight[:, None], wanted * weight, rcond=None)[0]
        miss = np.abs(wanted - columns @ fit)
        weight = 1.0 / np.hypot(1.0, miss / (1.5 * np.median(miss) + 1e-9))
    return np.asarray(fit)
