"""Samples of a sensor at its own, uneven times → every millisecond of another clock."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline
from scipy.signal import firwin, upfirdn

from hframe_post.arrays import Array

RATE = 1000.0  # of commands, samples a second
DEGREE = 5
CUTOFF_HZ, KAISER, FILTER_MS = 500.0, 8.0, 6  # linear phase: flat to 250 Hz, −80 dB from 750 Hz


class Resampler:
    """Samples a (n, 3) at rising times t (n,) in s, as a function of time from the first on.

    period: s from one sample to the next, the median; seconds: from the first to the last.
    """

    def __init__(self, t: Array, a: Array) -> None:
        t = t - t[0]
        self.period = float(np.median(np.diff(t)))
        self.seconds = float(t[-1])
        self._spline: BSpline = make_interp_spline(t, a, DEGREE)
        self._factor = int(np.ceil(1.0 / (self.period * RATE)))

    def resampled(self, start: float, drift: float, m: int) -> Array:
        """Accelerations (m, 3) every 1 ms of the command's clock, free of aliases.

        Interpolated at a multiple of 1 kHz that is not below the sensor's rate, then decimated
        with linear phase. Outside the recording its first and last samples go on.
        """
        factor = self._factor
        half = FILTER_MS * factor
        k = np.arange(-half, (m - 1) * factor + half + 1)
        clock = start + (1.0 + drift) * k / (RATE * factor)
        values = self._spline(np.clip(clock, 0.0, self.seconds))
        if factor == 1:
            return np.asarray(values[half : half + m])
        taps = firwin(2 * half + 1, CUTOFF_HZ, window=("kaiser", KAISER), fs=RATE * factor)
        first = 2 * half // factor
        return np.asarray(upfirdn(taps, values, 1, factor, axis=0)[first : first + m])
