"""When a recording began, how fast its clock runs, and where the printer's axes lie in it.

A sensor's clock starts elsewhere and runs at another rate: t_sensor = start + (1 + drift)·t.

**A known start.** Klipper's samples have times of its print time, in which it also plays the
motion. The start of a command on that clock is

- the time in the recording's name at which the motion had ended, less the command's duration;
- without it, half a sample before the first sample, since Klipper keeps the samples from the first
  call of ACCELEROMETER_MEASURE on.

The printer's axes in those of the sensor follow from slow motion, in which the nozzle does what it
is commanded. What it adds to that grows with the frequency, in phase and with a quarter turn:

    a ≈ D·u + E·du/dt + F·d²u/dt² + b,   D (3, 2): where x and y point, as the sensor sees them

No mounting is wrong: a sensor on a bed that moves sees y the other way round, and owners mirror
axes in printer.cfg, since a spectrum does not show a sign.

**A start that nothing tells.** TEST_RESONANCES, and most other programs, do not tell when the
motion began. First, pieces of the command are searched for together, correlated as an envelope, |⟨u
+ jû, a⟩| with û the Hilbert transform of u, because a plant shifts the phase (racking by 90° to
begin with). Then the clock is refined: the same frequency is excited at several times, by the sine,
by its harmonics and by slow motion beneath it, and on the right clock all of them have one phase,
so that the command explains most of the recording. What is left of the start is part of the delay
that the estimation finds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.fft import irfft, rfft, rfftfreq
from scipy.interpolate import BSpline, make_interp_spline
from scipy.ndimage import maximum_filter1d
from scipy.signal import fftconvolve, firwin, hilbert, upfirdn

from hframe_post.arrays import TS, Array, Integers, X, Y
from hframe_post.errors import IdentificationError
from hframe_post.identification.recordings.accelerometer import (
    GRAVITY,
    PLAUSIBLE,
    Recording,
    at_rest,
)

RESTING = 16  # samples before and after a motion; a spline feels none farther away


def acceleration(position: Array) -> Array:
    """Return the second derivative (m,), mm/s², of positions (m,) in mm every 1 ms.

    It is that of a spline, with a gain within 1e-5 up to 100 Hz; the second difference would be
    2 % low at 80 Hz. Before and after, the position rests where it begins and ends: at the ends of
    its samples alone a spline is free to turn as steeply as it likes. Raises IdentificationError
    for fewer samples than a spline needs.
    """
    degree = 7
    if len(position) <= degree:
        raise IdentificationError(f"a command of {len(position)} ms is too short to be a motion")
    resting = np.pad(position - position[0], RESTING, mode="edge")
    k = np.arange(len(resting), dtype=np.float64)
    spline = make_interp_spline(k, resting, degree)
    return np.asarray(spline.derivative(2)(k[RESTING:-RESTING]) / TS**2)


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
        "'hframe-post measure --for planner'"
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
        drift += _refined(command, sensor.resampled(start, drift, len(command)), within)
    acceleration = sensor.resampled(start, drift, len(whole))
    clock = start + (1.0 + drift) * TS * np.arange(len(whole))
    recorded = (clock >= 0.0) & (clock <= sensor.seconds)
    whole, acceleration = whole * recorded, acceleration * recorded[:, None]
    up = recording.a.mean(axis=0)
    size = float(np.linalg.norm(up))
    up = up / size if 0.5 * GRAVITY < size < 1.5 * GRAVITY else np.zeros(3)
    return SelfAligned(whole, acceleration, up, start, drift)


def _refined(command: Array, acceleration: Array, reach: float) -> float:
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


PLAYED_SD = 2e-5  # s: by how much Klipper plays a motion longer or shorter than its command
AGREED = 1e-3  # s by which the two starts may differ, beyond the time between samples
SHORTEST_STOP = 0.1  # s by which Klipper moves the print time at least, once its queue is empty
QUIET = 0.5  # s at the start of a recording in which the printer is at rest
SLOW_HZ = (2.0, 10.0)
LEAST_SHOWN = 0.3  # share of the command that the sensor must show in slow motion
LARGEST_LAG = 0.03  # s between a command and what the sensor shows; no printer lags more
PART, LAG_REACH = 8000, 2000  # samples of a part that must follow in time, and of its search
LEAST_LIKENESS = 0.4
MISSING = 0.5  # s at either end, in which the motion rests


@dataclass(frozen=True, slots=True)
class KnownStart:
    """When a command began: s on the clock of its recording, and the standard deviation of that."""

    at: float
    sd: float


def known_start(
    recording: Recording, samples: int, ended: float | None
) -> tuple[KnownStart, tuple[str, ...]]:
    """Return the start of a command of that many samples, and what was unusual about it.

    ended: print time in s at which the motion had ended, if the recording's name tells. Raises
    IdentificationError if nothing tells.
    """
    period = recording.period
    if not recording.started:
        if ended is None:
            raise IdentificationError(
                "nothing tells when its motion began. Let Klipper record it, by the file of "
                "'hframe-post measure'"
            )
        return KnownStart(ended - (samples - 1) * TS, PLAYED_SD), ()
    first = KnownStart(float(recording.t[0]) - period / 2.0, period / 12.0**0.5)
    if ended is None:
        return first, ()
    start = KnownStart(ended - (samples - 1) * TS, PLAYED_SD)
    off = start.at - first.at
    missed = abs(off) - period / 2.0
    if missed <= AGREED:
        return start, ()
    differ = f"the time in its name and its first sample differ by {1e3 * abs(off):.3g} ms"
    if missed <= SHORTEST_STOP:  # its time stamps wander, or the host was late
        return KnownStart(start.at, missed), (differ,)
    # another command has moved the print time after the motion; or the motion stopped, which shows
    return first, (f"{differ}: the sample counts",)


def on_command_clock(command: Array, recording: Recording, start: KnownStart) -> Array:
    """Return the acceleration (m, 3), mm/s², along the printer's axes at each row of a command.

    command (m, 2): mm every 1 ms, at rest for a second at both ends; recording: in any axes, also
    left-handed ones. Gravity and offset are removed, the sensor's gains are not. The band is that
    of the sensor: up to 250 Hz of 3200 samples a second. Raises IdentificationError if the
    recording does not follow the command in time, or does not cover it.
    """
    begin = start.at - float(recording.t[0])
    rest = at_rest(recording, QUIET)
    sensor = Resampler(recording.t, recording.a - rest)
    sensor.check_covers(begin, begin + (len(command) - 1) * TS, MISSING)
    a = sensor.resampled(begin, 0.0, len(command))
    moved = [axis for axis in (0, 1) if np.ptp(command[:, axis]) > 0.0]
    u = np.column_stack([acceleration(command[:, axis]) for axis in moved])
    slow, shown = (banded(values, SLOW_HZ) for values in (u, a))
    _check_in_time(slow, shown)
    rates = np.gradient(slow, TS, axis=0)
    columns = np.hstack([slow, rates, np.gradient(rates, TS, axis=0)])
    D = np.linalg.lstsq(columns / columns.std(axis=0), shown, rcond=None)[0]
    D = (D / columns.std(axis=0)[:, None])[: len(moved)]
    if (np.linalg.norm(D, axis=1) < LEAST_SHOWN).any():
        raise not_found()
    return np.asarray(a @ np.linalg.inv(completed(D, moved, rest)))


def completed(D: Array, moved: Sequence[int], rest: Array) -> Array:
    """Return the printer's axes as the sensor sees them: unit vectors x, y, z, in rows (3, 3).

    D (k, 3): where the axes that moved point, of any length; rest (3,): what the sensor shows at
    rest. Raises IdentificationError without gravity, if one axis moved.
    """
    D = D / np.linalg.norm(D, axis=1, keepdims=True)
    rows = np.zeros((3, 3))
    rows[list(moved)] = D
    strength = float(np.linalg.norm(rest))
    if len(moved) == 2:
        rows[2] = np.cross(rows[X], rows[Y])
        rows[2] *= np.sign(rows[2] @ rest) or 1.0
    elif PLAUSIBLE[0] <= strength <= PLAUSIBLE[1]:
        along = D[0]
        up = rest / strength - (along @ rest) / strength * along
        rows[2] = up / np.linalg.norm(up)
        rows[1 - moved[0]] = np.cross(rows[2], along) * (1.0 if moved[0] == X else -1.0)
    else:
        raise IdentificationError(
            f"at rest the sensor shows {strength / 1000.0:.4g} m/s² instead of gravity, so "
            "its axes are unknown. Record both axes at once"
        )
    return rows


def _check_in_time(slow: Array, shown: Array) -> None:
    """Raise IdentificationError unless each part of a recording follows its command.

    slow (m, k), shown (m, 3): slow parts of the command's acceleration and of the recording.
    """
    for first in range(0, len(slow) - PART // 2, PART):
        likeness, lag = _lag(slow, shown, first)
        if likeness < LEAST_LIKENESS:
            raise not_found()
        if abs(lag) <= LARGEST_LAG:
            continue
        if first == 0:
            raise IdentificationError(
                f"the motion begins {abs(lag):.2f} s {'after' if lag > 0.0 else 'before'} its "
                "recording shows it. Was another motion recorded, or the recording begun by hand?"
            )
        raise IdentificationError(
            f"the motion stopped for {abs(lag):.2f} s, {first * TS:.0f} s or less after it began: "
            "the queue of the firmware ran empty. Print the file from the virtual SD card, while "
            "nothing else keeps the host busy"
        )


def _lag(slow: Array, shown: Array, first: int) -> tuple[float, float]:
    """Return the likeness, 0 … 1, of a part of a recording to its command, and its lag in s."""
    part = slow[first : first + PART]
    low = max(first - LAG_REACH, 0)
    region = shown[low : first + len(part) + LAG_REACH]
    products = sum(
        fftconvolve(a, u[::-1], "valid") ** 2 / (u @ u) for u in part.T for a in region.T
    )
    best = int(np.argmax(products))
    energy = (region[best : best + len(part)] ** 2).sum()
    return float(np.sqrt(products[best] / max(energy, 1e-300))), (low + best - first) * TS
