"""The sensor's clock relative to that of the command, and recordings resampled to the latter.

A sensor's clock starts elsewhere and runs at another rate: t_sensor = start + (1 + drift)·t.
Pieces of the command are searched for in the recording. They are correlated as an envelope,
|⟨u + jû, a⟩| with û the Hilbert transform of u, because a plant shifts the phase (racking by 90° to
begin with).
"""

from __future__ import annotations

import numpy as np
from scipy.fft import irfft, rfft, rfftfreq
from scipy.interpolate import BSpline, make_interp_spline
from scipy.ndimage import maximum_filter1d
from scipy.signal import fftconvolve, firwin, hilbert, upfirdn

from hframe_post.arrays import TS, Array, Integers
from hframe_post.errors import IdentificationError

RATE = 1000.0  # of commands, samples a second
MOST_DRIFT = 0.022  # a little more than the worst clocks have
AT_REST = 1e-3  # share of the greatest acceleration below which a command is at rest
WINDOW, WINDOWS, SHORTEST = 2000, 24, 250  # length in samples, and number
CLOCKS, SOME = 11, 3  # drifts that are tried at once, and every how many windows count at first
FINER_GRIDS = 2
UNKNOWN_START = 0.25  # s between start and response that no plant explains
REACH = int(UNKNOWN_START * RATE)
DISPERSION = 0.02  # s by which a plant's delay may differ from window to window


class Resampler:
    """Samples a (n, 3) at rising times t (n,) in s, as a function of the time since the first.

    period: median time between samples, s; seconds: from the first sample to the last.
    """

    def __init__(self, t: Array, a: Array) -> None:
        t = t - t[0]
        self.period = float(np.median(np.diff(t)))
        self.seconds = float(t[-1])
        self._spline: BSpline = make_interp_spline(t, a, 5)
        self._factor = int(np.ceil(1.0 / (self.period * RATE)))

    def resampled(self, start: float, drift: float, m: int) -> Array:
        """Return accelerations (m, 3) every 1 ms of the command's clock, without aliases.

        Interpolates at a multiple of 1 kHz not below the sensor's rate, then decimates with
        linear phase: flat to 250 Hz, −80 dB from 750 Hz. Outside the recording its first and
        last samples continue.
        """
        factor = self._factor
        half = 6 * factor  # of the filter's length: 6 ms
        k = np.arange(-half, (m - 1) * factor + half + 1)
        clock = start + (1.0 + drift) * k / (RATE * factor)
        values = self._spline(np.clip(clock, 0.0, self.seconds))
        if factor == 1:
            return np.asarray(values[half : half + m])
        taps = firwin(2 * half + 1, 500.0, window=("kaiser", 8.0), fs=RATE * factor)
        first = 2 * half // factor
        return np.asarray(upfirdn(taps, values, 1, factor, axis=0)[first : first + m])

    def check_covers(self, first: float, last: float, missing: float = 0.0) -> None:
        """Raise IdentificationError if more of a motion is missing, s, than there may be.

        first, last: s after the first sample at which the motion begins and ends.
        """
        if first < -missing:
            raise IdentificationError(f"the recording begins {-first:.2f} s after its motion does")
        if last > self.seconds + missing:
            late = last - self.seconds
            raise IdentificationError(f"the recording ends {late:.2f} s before its motion does")


def moving_samples(command: Array) -> Integers:
    """Return the indices of samples at which a command (m,), an acceleration, is not at rest."""
    return np.flatnonzero(np.abs(command) > AT_REST * np.abs(command).max(initial=0.0))


# ---------------------------------------------------------------------- start and drift


def clock_from_windows(command: Array, moving: Integers, sensor: Resampler) -> tuple[float, float]:
    """Return start (s) and drift, to 20 ms over the recording.

    They are those of the clock on which the windows are found together: of a coarse grid of drifts
    first, and then of finer ones near it. A plant whose delay changes along the sweep looks like a
    drift: less than it explains is none. Raises IdentificationError if the command is too short.
    """
    windows = _Windows(command, moving, sensor)
    grid = np.linspace(-MOST_DRIFT, MOST_DRIFT, CLOCKS)
    start, drift = windows.clock(grid, SOME)
    for _ in range(FINER_GRIDS):
        grid *= 2.0 / (CLOCKS - 1)  # from one drift of the coarser grid to the next
        start, drift = windows.clock(drift + grid, 1, start)
    return start, 0.0 if abs(drift) * windows.span < DISPERSION else drift


class _Windows:
    """Pieces of a command, searched for together in a recording.

    Late in a chirp a single one may be lost in noise, or be most like another piece.
    """

    def __init__(self, command: Array, moving: Integers, sensor: Resampler) -> None:
        self._command = command
        self._length = min(WINDOW, int(moving[-1] - moving[0]) // 4)
        if self._length < SHORTEST:
            raise IdentificationError(
                f"the command moves for {4 * self._length * TS:.2g} s, which is too short"
            )
        last = moving[-1] - self._length
        self._places = np.unique(np.linspace(moving[0], last, WINDOWS).astype(np.int64))
        track = sensor.resampled(0.0, 0.0, int(sensor.seconds * RATE) + 1)
        # the first and last window may not have been recorded whole
        self._track = np.pad(banded(track, _followed_band(command)), ((REACH, REACH), (0, 0)))

    @property
    def span(self) -> float:
        """Return the seconds from the first window to the last."""
        return float(self._places[-1] - self._places[0]) * TS

    def clock(self, drifts: Array, every: int, near: float | None = None) -> tuple[float, float]:
        """Return start, s, and drift of the clock on which the windows are most alike together.

        drifts: those that are tried, equally far apart. every: of how many windows one counts.
        near: the start, if it is known to UNKNOWN_START.
        """
        width = float(drifts[1] - drifts[0])
        found = [(*self._likeness(d, width, every, near), d) for d in drifts.tolist()]
        return max(found)[1:]

    def _likeness(
        self, drift: float, width: float, every: int, near: float | None
    ) -> tuple[float, float]:
        """Return the windows' greatest likeness in all, on a clock, and the start, s, there.

        width: how far the drift may be off. On a clock that is 1 % off, a window of fast motion is
        not like its own response.
        """
        rate, first = 1.0 + drift, int(self._places[0])
        low, high = 0, len(self._track)  # between which the first window is sought
        if near is not None:
            low = max(round(near * RATE + rate * first), 0)
            high = low + 2 * REACH + 1
        total = np.zeros(high - low)
        samples, k = np.arange(len(self._command)), np.arange(self._length) / rate
        for place in self._places[::every]:
            since = int(rate * (place - first))
            region = self._track[low + since : high + since + self._length - 1]
            pattern = np.interp(place + k, samples, self._command)
            # a chirp that is late looks stretched, and the other way round: twice as far
            wide = 2 * int(width * (place - first)) + 1
            likeness = maximum_filter1d(_envelope(pattern, region), wide, mode="constant")
            total[: len(likeness)] += likeness
        at = int(np.argmax(total))
        return float(total[at]), (low + at - REACH - rate * first) * TS


# ---------------------------------------------------------------------- correlation


def _envelope(pattern: Array, track: Array) -> Array:
    """Return the likeness 0 … 1 of pattern (p,) to track (n, 3) from each sample, (n − p + 1,)."""
    analytic = hilbert(pattern - pattern.mean())
    strength = (analytic.real**2).sum()
    if len(track) < len(pattern) or strength == 0.0:
        return np.zeros(1)
    reversed_ = analytic.conj()[::-1]
    products = [fftconvolve(values, reversed_, "valid") for values in track.T]
    power = sum(np.abs(product) ** 2 for product in products)
    return np.asarray(np.sqrt(power / (strength * _energy(track, len(pattern)))))


def _energy(track: Array, n: int) -> Array:
    """Return the energy of n samples from each on, never quite 0."""
    total = np.concatenate([[0.0], np.cumsum((track**2).sum(axis=1))])
    energy = total[n:] - total[:-n]
    return np.asarray(np.maximum(energy, 1e-6 * energy.max() + 1e-300))


def energy_band(command: Array, shares: tuple[float, float]) -> tuple[float, float]:
    """Return the frequencies (Hz) below which these shares of the command's energy lie."""
    below = np.cumsum(np.abs(rfft(command)) ** 2)
    low, high = rfftfreq(len(command), TS)[np.searchsorted(below, np.array(shares) * below[-1])]
    return float(low), float(high)


def banded(values: Array, band_hz: tuple[float, float]) -> Array:
    """Return the part of values (n, k), one a millisecond, that lies in a band of frequencies."""
    hz = rfftfreq(len(values), TS)
    spectra = rfft(values, axis=0)
    spectra[(hz < band_hz[0]) | (hz > band_hz[1])] = 0.0
    return np.asarray(irfft(spectra, len(values), axis=0))


def _followed_band(command: Array) -> tuple[float, float]:
    """Return the band (Hz) of a command and what is near it, without motor steps and drift."""
    low, high = energy_band(command, (0.01, 0.99))
    return low / 1.5, high * 1.5


def not_found() -> IdentificationError:
    return IdentificationError(
        "the recording does not follow the command. Check that it is of this motion, complete, and "
        "of a sensor that moves with this axis. With Marlin also check the planner of the profile: "
        "'hframe-post calibrate-marlin'"
    )
