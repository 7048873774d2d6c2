"""How a sensor's clock runs beside that of the command it heard.

A sensor's clock starts elsewhere and runs at another rate: t_sensor = start + (1 + drift)·t.
A sweep hides both, since a stretched answer to it is just that of another plant. So a command
that can be aligned well has two equal marks, one before and one after the sweep: the answer to
the second is that to the first, later, whatever the plant.

Everything is correlated as an envelope, |⟨u + jû, a⟩| with û the Hilbert transform of u: a
plant turns the phase, and racking by 90° to begin with.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft, rfftfreq
from scipy.ndimage import maximum_filter1d
from scipy.signal import fftconvolve, hilbert

from hframe_post.arrays import TS, Array, Complex, Integers
from hframe_post.errors import IdentificationError
from hframe_post.identification.recordings.resampling import RATE, Resampler

MOST_DRIFT = 0.022  # a little more than clocks of the worst kind
QUIETEST = 1e-3  # of the greatest acceleration, below which a command stands,
PAUSE = 60  # if for so many samples
MARK_LEAD, MARK_TAIL = 10, 480  # samples before and after a mark in which its answer is sought
BESIDE = 1.5  # times its band, in which an answer is sought; motor steps are heard above
WINDOW, WINDOWS = 2000, 24  # samples; of a command without marks,
SHORTEST = 250  # which may be shorter
AWAY = 0.25  # s by which a window's answer may be off, beside drift
ROUNDS = 6
DISPERSION = 0.02  # s by which a plant's lag may differ from window to window
POOR = 0.4  # correlation below which a recording is of something else


@dataclass(frozen=True, slots=True)
class Marks:
    """Sample indices: starts of both marks, their length, and that of their answers."""

    first: int
    second: int
    length: int
    answer: int


def marks_of(command: Array, moving: Integers) -> Marks | None:
    """The first and last stretch between rests, if they are equal."""
    breaks = np.flatnonzero(np.diff(moving) > PAUSE)
    starts, ends = moving[np.r_[0, breaks + 1]], moving[np.r_[breaks, -1]] + 1
    if len(starts) < 3 or ends[0] - starts[0] != ends[-1] - starts[-1]:
        return None
    first, second = (command[s:e] for s, e in ((starts[0], ends[0]), (starts[-1], ends[-1])))
    if np.abs(first - second).max() > QUIETEST * np.abs(command).max():
        return None
    rests = (starts[0], starts[1] - ends[0], len(command) - ends[-1])
    tail = min(MARK_TAIL, int(min(rests) * 0.8))
    return Marks(int(starts[0]), int(starts[-1]), len(first), len(first) + tail)


def by_marks(command: Array, marks: Marks, track: Array) -> tuple[float, float]:
    """(start, drift) from the two marks; track (n, 3): the recording every 1 ms of its clock.

    The start still contains the plant's lag.
    """
    distance = marks.second - marks.first
    width = int(np.ceil(MOST_DRIFT * distance)) + 1
    mark = command[marks.first : marks.first + marks.length]
    track = _within(track, band_of(mark, (0.01, 0.99)))
    track = np.concatenate([track, np.zeros((marks.answer, 3))])  # where it ends, it is at rest
    heard = _envelope(mark, track)
    padded = np.concatenate([heard, np.zeros(distance + width)])
    later = maximum_filter1d(padded, 2 * width + 1, mode="constant")[distance:][: len(heard)]
    at = int(np.argmax(heard * later))
    lag = _mark_to_mark(track, max(at - MARK_LEAD, 0), marks, distance, width)
    drift = lag / distance - 1.0
    return at * TS - (1.0 + drift) * marks.first * TS, drift


def _mark_to_mark(track: Array, at: int, marks: Marks, distance: int, width: int) -> float:
    """Samples from the answer to the first mark, which begins at ``at``, to that to the second."""
    n = marks.answer + MARK_LEAD
    answer = track[at : at + n]
    low = max(at + distance - width, 0)
    region = track[low : at + distance + width + n]
    if len(region) < n or len(answer) < n:
        raise unlike()
    products = sum(
        fftconvolve(r, a[::-1], "valid") for r, a in zip(region.T, answer.T, strict=True)
    )
    likeness = products / np.sqrt(_energy(region, n) * max((answer**2).sum(), 1e-300))
    best = int(np.argmax(likeness))
    if likeness[best] < POOR:
        raise unlike()
    repeated = region[best : best + n]
    size = next_fast_len(2 * n, real=True)
    omega = 2.0 * np.pi * rfftfreq(size)
    cross = (rfft(answer, size, axis=0).conj() * rfft(repeated, size, axis=0)).sum(axis=1)
    return low + best - at + _peak(cross, omega)


def _peak(cross: Complex, omega: Array) -> float:
    """Lag in samples, near 0, at which the correlation with spectrum ``cross`` is greatest."""
    lag = 0.0
    for _ in range(ROUNDS):
        turning = cross * np.exp(1j * omega * lag)
        slope, curve = -(omega * turning.imag).sum(), -(omega**2 * turning.real).sum()
        lag -= float(np.clip(slope / curve, -1.0, 1.0)) if curve < 0.0 else 0.0
    return lag


def by_windows(
    command: Array, moving: Integers, sensor: Resampler, started: bool
) -> tuple[float, float, float]:
    """(start, drift, half-width of what is not known of the delay in s), without marks.

    A late chirp looks like a stretched one. So the windows' lags tell up to twice the drift,
    depending on the command; the secant method finds the drift at which they no longer grow.
    """
    windows = _Windows(command, moving, sensor)
    start = 0.0 if started else windows.rough_start()
    drift, step = 0.0, 0.5  # step: of the lags' growth, that is taken for drift
    lag, growth = windows.lag(start, drift)
    for _ in range(ROUNDS):
        following = float(np.clip(drift + step * growth, -MOST_DRIFT, MOST_DRIFT))
        if abs(following - drift) * windows.span < TS:
            break
        start += lag
        lag, growth_after = windows.lag(start, following)
        if growth_after != growth:
            step = min(max((following - drift) / (growth - growth_after), 0.3), 1.0)
        drift, growth = following, growth_after
    if abs(drift) * windows.span < DISPERSION:
        return start + lag, 0.0, 0.0
    return start + lag, drift, DISPERSION


class _Windows:
    """Pieces of a command, each looked for in the recording by itself."""

    def __init__(self, command: Array, moving: Integers, sensor: Resampler) -> None:
        self._command, self._sensor = command, sensor
        self._length = min(WINDOW, int(moving[-1] - moving[0]) // 4)
        if self._length < SHORTEST:
            raise IdentificationError(
                f"a command that moves for {4 * self._length * TS:.2g} s is too short"
            )
        last = moving[-1] - self._length
        self._places = np.unique(np.linspace(moving[0], last, WINDOWS).astype(np.int64))
        self._samples = int(sensor.seconds * RATE) + 1
        self._band = band_of(command, (0.01, 0.99))

    @property
    def span(self) -> float:
        """Seconds from the first window to the last."""
        return float(self._places[-1] - self._places[0]) * TS

    def lag(self, start: float, drift: float) -> tuple[float, float]:
        """How late the windows are on that clock, s, and by how much that grows per second."""
        track = _within(self._sensor.resampled(start, drift, self._samples), self._band)
        lags = []
        for place in self._places:
            reach = int((2.5 * MOST_DRIFT * place * TS + AWAY) * RATE)
            first = max(int(place) - reach, 0)
            region = track[first : int(place) + self._length + reach]
            heard = _envelope(self._command[place : place + self._length], region)
            lags.append((first + int(np.argmax(heard)) - place) * TS)
        growth, mean = np.polyfit(self._places * TS, lags, 1)
        return float(mean), float(growth)

    def rough_start(self) -> float:
        """Where on the recording's clock the command starts, s, as most windows have it."""
        track = self._sensor.resampled(0.0, 0.0, self._samples)
        first = self._places[0]
        total = np.zeros(len(track))
        for place in self._places:
            heard = _envelope(self._command[place : place + self._length], track)
            wide = int(2.0 * MOST_DRIFT * (place - first)) * 2 + 1
            spread = maximum_filter1d(heard, wide, mode="constant")[place - first :]
            total[: len(spread)] += spread
        return float(np.argmax(total) - first) * TS


# ----------------------------------------------------------------- correlation


def _envelope(pattern: Array, track: Array) -> Array:
    """Likeness 0 … 1 of the pattern (p,) to track (n, 3) from each sample on, (n − p + 1,)."""
    analytic = hilbert(pattern - pattern.mean())
    strength = (analytic.real**2).sum()
    if len(track) < len(pattern) or strength == 0.0:
        return np.zeros(1)
    reversed_ = analytic.conj()[::-1]
    products = [fftconvolve(values, reversed_, "valid") for values in track.T]
    power = sum(np.abs(product) ** 2 for product in products)
    return np.asarray(np.sqrt(power / (strength * _energy(track, len(pattern)))))


def _energy(track: Array, n: int) -> Array:
    """Energy of n samples from each on, never quite 0."""
    total = np.concatenate([[0.0], np.cumsum((track**2).sum(axis=1))])
    energy = total[n:] - total[:-n]
    return np.asarray(np.maximum(energy, 1e-6 * energy.max() + 1e-300))


def band_of(command: Array, shares: tuple[float, float]) -> tuple[float, float]:
    """Frequencies (Hz) below which these shares of the command's energy lie."""
    below = np.cumsum(np.abs(rfft(command)) ** 2)
    low, high = rfftfreq(len(command), TS)[np.searchsorted(below, np.array(shares) * below[-1])]
    return float(low), float(high)


def _within(track: Array, band: tuple[float, float]) -> Array:
    """The track (n, 3) in a band of Hz, and a little beside it."""
    hz = rfftfreq(len(track), TS)
    spectra = rfft(track, axis=0)
    spectra[(hz < band[0] / BESIDE) | (hz > band[1] * BESIDE)] = 0.0
    return np.asarray(irfft(spectra, len(track), axis=0))


def unlike() -> IdentificationError:
    """The error of a recording in which the command cannot be found."""
    return IdentificationError(
        "the recording does not follow the command: was the sweep played, and is this its "
        "recording, whole and of this sensor?"
    )
