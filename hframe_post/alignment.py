"""A recording on the clock of the command it is the answer to.

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
from scipy.fft import fft, fftfreq, ifft, irfft, next_fast_len, rfft, rfftfreq
from scipy.interpolate import BSpline, make_interp_spline
from scipy.ndimage import maximum_filter1d
from scipy.signal import csd, fftconvolve, firwin, hilbert, upfirdn, welch

from hframe_post.accelerometer import AXES, Recording
from hframe_post.arrays import Array, Complex, Integers
from hframe_post.errors import IdentificationError

RATE = 1000.0  # of commands, samples a second
TS = 1.0 / RATE
COMMAND_DEGREE = 7  # of the spline: gain of its second derivative within 1e-5 to 100 Hz
SENSOR_DEGREE = 5
CUTOFF_HZ, KAISER, FILTER_MS = 500.0, 8.0, 6  # linear phase: flat to 250 Hz, −80 dB from 750 Hz
MOST_DRIFT = 0.012  # a little more than clocks of the worst kind
QUIETEST = 1e-3  # of the greatest acceleration, below which a command stands,
PAUSE = 60  # if for so many samples
MARK_LEAD, MARK_TAIL = 10, 480  # samples before and after a mark in which its answer is sought
BESIDE = 1.5  # times its band, in which an answer is sought; motor steps are heard above
WINDOW, WINDOWS = 2000, 24  # samples; of a command without marks
ROUNDS = 6
DISPERSION = 0.02  # s by which a plant's lag may differ from window to window
RISE = 0.3  # of an impulse response's envelope that counts as its onset,
ONSET = 0.01  # which is so near to 0 s: from −8 to 9 ms, of the paper's plants and 40 others
AWAY = 0.25  # s between start and answer that is no plant's doing
SEGMENT = 1024  # samples over which an answer's spectrum is taken
POOR = 0.4  # correlation below which a recording is of something else
OTHER_AXIS = 2.0  # times the channel's motion that another may show,
SLOW_HZ = 12.0  # up to this frequency
HEADING_HZ = (2.0, 8.0)
BAND_HZ = 0.5  # in which noise is averaged
LEAST_LOW = 1e-4  # of the command's energy that must be slow to say something
MOST_HEADING = np.radians(45.0)


@dataclass(frozen=True, slots=True)
class Aligned:
    """A recording on the command's clock.

    acceleration (m, 3): mm/s² every 1 ms; start: s on the sensor's clock when the command
    began; drift: by how much that clock runs fast; uncertainty: s, half-width of what is not
    known of the delay; correlation: share of the channel's amplitude that the command explains.
    """

    acceleration: Array
    start: float
    drift: float
    uncertainty: float
    correlation: float


def acceleration(position: Array) -> Array:
    """Second derivative (m,), mm/s², of positions (m,) in mm every 1 ms, as band-limited.

    Not the second difference, whose gain is 2 % low at 80 Hz. Raises IdentificationError for
    fewer samples than a spline needs.
    """
    if len(position) <= COMMAND_DEGREE:
        raise IdentificationError(f"a command of {len(position)} ms is no motion")
    k = np.arange(len(position), dtype=np.float64)
    spline = make_interp_spline(k, position - position[0], COMMAND_DEGREE)
    return np.asarray(spline.derivative(2)(k) / TS**2)


def aligned(command: Array, recording: Recording, channel: int) -> Aligned:
    """The recording on the command's clock, by the answer in ``channel`` (0, 1, 2: x, y, z).

    command (m,): mm/s² every 1 ms. Drift comes from the command's two marks. A command without
    them is correlated in windows, which cannot tell drift from a plant whose lag changes along
    the sweep: clocks are then taken as one unless they differ by more than any plant explains
    (20 ms over the run), and if they do, as much stays unknown. The start is that of the
    recording if it is ``started``, else where the answer sets in, as far as the sweep's band
    shows it: 10 ms to either side stay unknown.

    Raises IdentificationError where the recording does not cover the command or does not
    follow it, or follows it in another channel.
    """
    moving = np.flatnonzero(np.abs(command) > QUIETEST * np.abs(command).max(initial=0.0))
    if not moving.size:
        raise IdentificationError("the command does not move")
    sensor = _Sensor(recording)
    _check_length(sensor, moving, recording.started)
    track = sensor.resampled(0.0, 0.0, int(sensor.seconds * RATE) + 1)
    marks = _marks(command, moving)
    if marks is None:
        start, drift, unknown = _by_windows(command, moving, sensor, recording.started)
    else:
        start, drift, unknown = *_by_marks(command, marks, track), 0.0
    if recording.started:
        if abs(start) > AWAY:
            raise IdentificationError(
                f"the command's motion begins {start:.3g} s after the recording: it was not "
                "started by the sweep's own ACCELEROMETER_MEASURE, or belongs to another sweep"
            )
        start, unknown = -recording.period / 2.0, unknown + recording.period / 2.0
    else:
        a = sensor.resampled(start, drift, len(command))[:, channel]
        start, unknown = start + _onset(command, a), unknown + ONSET
    _check_covered(sensor, moving, start, drift)
    a = sensor.resampled(start, drift, len(command))
    correlation = _followed(command, a, channel)
    return Aligned(a, float(recording.t[0] + start), drift, unknown, correlation)


def heading(command: Array, acceleration: Array, axis: int) -> float:
    """By how much to turn (``turned``) the sensor on the nozzle about the vertical, rad.

    command (m,), acceleration (m, 3): mm/s², of a run of ``axis`` (0: x, 1: y). The slower the
    nozzle moves, the more it moves along that axis only: in a run of x racking across grows
    with j·f, which is fitted beside the angle from 2 to 8 Hz. At a lever arm of 50 mm the
    paper's printer leaves 0.1°. Raises IdentificationError beyond 45°, and where the command
    has nothing at these frequencies.
    """
    hz = rfftfreq(len(command), TS)
    sent = rfft(command)
    low = (hz >= HEADING_HZ[0]) & (hz <= HEADING_HZ[1])
    if (np.abs(sent[low]) ** 2).sum() < LEAST_LOW * (np.abs(sent) ** 2).sum():
        raise IdentificationError(
            f"how the sensor is turned about the vertical shows below {HEADING_HZ[1]:g} Hz: "
            "sweep from a lower frequency"
        )
    edges = np.searchsorted(hz, np.arange(HEADING_HZ[0], HEADING_HZ[1], BAND_HZ))
    last = int(np.flatnonzero(low)[-1]) + 1

    def banded(values: Complex) -> Complex:
        return np.asarray(np.add.reduceat((sent.conj() * values)[:last], edges))

    along, across = (
        banded(rfft(acceleration[:, k])) / np.sqrt(banded(sent).real) for k in (axis, 1 - axis)
    )
    f = hz[edges] / HEADING_HZ[1]
    columns = np.column_stack([along, 1j * f * along] if axis == 0 else [along])
    stacked = np.concatenate([columns.real, columns.imag])
    tangent = np.linalg.lstsq(stacked, np.concatenate([across.real, across.imag]))[0][0]
    forwards = np.sign(along.sum().real)
    angle = float(np.arctan2((-1.0 if axis == 0 else 1.0) * tangent * forwards, forwards))
    if abs(angle) > MOST_HEADING:
        raise IdentificationError(
            f"the sensor is turned by {np.degrees(abs(angle)):.0f}° about the vertical, as a run "
            f"of {AXES[axis]} tells: an axis or a sign of its axis map is wrong"
        )
    return angle


def turned(acceleration: Array, angle: float) -> Array:
    """Accelerations (m, 3) in axes turned by −``angle`` (rad) about z, same shape."""
    cos, sin = np.cos(angle), np.sin(angle)
    turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    return np.asarray(acceleration @ turn.T)


# ------------------------------------------------------------------ the sensor


class _Sensor:
    """A recording as a function of time; its clock is counted from its first sample."""

    def __init__(self, recording: Recording) -> None:
        t = recording.t - recording.t[0]
        self.seconds = float(t[-1])
        self._spline: BSpline = make_interp_spline(t, recording.a, SENSOR_DEGREE)
        self._factor = int(np.ceil(1.0 / (recording.period * RATE)))

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


def _check_length(sensor: _Sensor, moving: Integers, started: bool) -> None:
    asked = float(moving[-1] - (0 if started else moving[0])) * TS
    if sensor.seconds < asked * (1.0 - MOST_DRIFT):
        raise IdentificationError(
            f"the recording lasts {sensor.seconds:.4g} s, shorter than the command, whose "
            f"motion takes {asked:.4g} s"
        )


def _check_covered(sensor: _Sensor, moving: Integers, start: float, drift: float) -> None:
    first, last = start + (1.0 + drift) * TS * moving[[0, -1]]
    if first < 0.0:
        raise IdentificationError(f"the recording begins {-first:.3g} s after the motion")
    if last > sensor.seconds:
        raise IdentificationError(
            f"the recording ends {last - sensor.seconds:.3g} s before the command's motion does"
        )


# ----------------------------------------------------------------------- marks


@dataclass(frozen=True, slots=True)
class _Marks:
    """Sample indices: starts of both marks, their length, and that of their answers."""

    first: int
    second: int
    length: int
    answer: int


def _marks(command: Array, moving: Integers) -> _Marks | None:
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
    return _Marks(int(starts[0]), int(starts[-1]), len(first), len(first) + tail)


def _by_marks(command: Array, marks: _Marks, track: Array) -> tuple[float, float]:
    """(start, drift) from the two marks; track (n, 3): the recording every 1 ms of its clock.

    The start still contains the plant's lag.
    """
    distance = marks.second - marks.first
    width = int(np.ceil(MOST_DRIFT * distance)) + 1
    mark = command[marks.first : marks.first + marks.length]
    track = _within(track, _band(mark, (0.01, 0.99)))
    track = np.concatenate([track, np.zeros((marks.answer, 3))])  # where it ends, it is at rest
    heard = _envelope(mark, track)
    padded = np.concatenate([heard, np.zeros(distance + width)])
    later = maximum_filter1d(padded, 2 * width + 1, mode="constant")[distance:][: len(heard)]
    at = int(np.argmax(heard * later))
    lag = _mark_to_mark(track, max(at - MARK_LEAD, 0), marks, distance, width)
    drift = lag / distance - 1.0
    return at * TS - (1.0 + drift) * marks.first * TS, drift


def _mark_to_mark(track: Array, at: int, marks: _Marks, distance: int, width: int) -> float:
    """Samples from the answer to the first mark, which begins at ``at``, to that to the second."""
    n = marks.answer + MARK_LEAD
    answer = track[at : at + n]
    low = max(at + distance - width, 0)
    region = track[low : at + distance + width + n]
    if len(region) < n or len(answer) < n:
        raise _unlike()
    products = sum(
        fftconvolve(r, a[::-1], "valid") for r, a in zip(region.T, answer.T, strict=True)
    )
    likeness = products / np.sqrt(_energy(region, n) * max((answer**2).sum(), 1e-300))
    best = int(np.argmax(likeness))
    if likeness[best] < POOR:
        raise _unlike()
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


# --------------------------------------------------------------------- windows


def _by_windows(
    command: Array, moving: Integers, sensor: _Sensor, started: bool
) -> tuple[float, float, float]:
    """(start, drift, half-width of what is not known of the delay in s), without marks.

    A chirp that is late looks like one that is stretched, so windows show the drift up to
    twofold, by the kind of command; the secant method needs not know.
    """
    length = min(WINDOW, len(command) // 4)
    places = np.unique(np.linspace(moving[0], moving[-1] - length, WINDOWS).astype(np.int64))
    span = float(places[-1] - places[0]) * TS
    n = int(sensor.seconds * RATE) + 1
    band = _band(command, (0.01, 0.99))

    def lags(start: float, drift: float, reach: float) -> tuple[float, float]:
        """Of windows over time: (mean, slope)."""
        track = _within(sensor.resampled(start, drift, n), band)
        found = []
        for place in places:
            low = max(int(place - (reach * place * TS + AWAY) * RATE), 0)
            high = int(place + length + (reach * place * TS + AWAY) * RATE)
            heard = _envelope(command[place : place + length], track[low:high])
            found.append((low + int(np.argmax(heard)) - place) * TS)
        slope, mean = np.polyfit(places * TS, found, 1)
        return float(mean), float(slope)

    start = 0.0 if started else _rough_start(command, places, length, sensor.resampled(0, 0, n))
    reach, drift, step = 2.5 * MOST_DRIFT, 0.0, 0.5
    offset, slope = lags(start, drift, reach)
    for _ in range(ROUNDS):
        following = float(np.clip(drift + step * slope, -MOST_DRIFT, MOST_DRIFT))
        if abs(following - drift) * span < TS:
            break
        start += offset
        offset, after = lags(start, following, reach)
        if after != slope:
            step = min(max((following - drift) / (slope - after), 0.3), 1.0)
        drift, slope = following, after
    if abs(drift) * span < DISPERSION:
        return start + offset, 0.0, 0.0
    return start + offset, drift, DISPERSION


def _rough_start(command: Array, places: Integers, length: int, track: Array) -> float:
    """Where the recording's start lies, s, as most windows have it."""
    total = np.zeros(len(track))
    for place in places:
        heard = _envelope(command[place : place + length], track)
        wide = int(2.0 * MOST_DRIFT * (place - places[0])) * 2 + 1
        spread = maximum_filter1d(heard, wide, mode="constant")[place - places[0] :]
        total[: len(spread)] += spread
    return float(np.argmax(total) - places[0]) * TS


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


def _band(command: Array, shares: tuple[float, float]) -> tuple[float, float]:
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


def _onset(command: Array, a: Array) -> float:
    """Where the answer a (m,) sets in, s: the first rise of its impulse response's envelope."""
    low, high = _band(command, (0.01, 0.99))
    n = next_fast_len(len(command) + int(2.0 * AWAY * RATE))
    hz = fftfreq(n, TS)
    sent = fft(command, n)
    power = np.abs(sent) ** 2
    inside = (hz >= low) & (hz <= high)
    window = np.sqrt(np.sin(np.pi * np.clip((hz - low) / (high - low), 0.0, 1.0)))
    response = window * sent.conj() * fft(a, n) / (power + power[inside].mean() * QUIETEST)
    envelope = np.abs(ifft(response))
    reach = int(AWAY * RATE)
    near = np.concatenate([envelope[-reach:], envelope[: reach + 1]])
    return float(np.argmax(near >= RISE * near.max()) - reach) * TS


def _followed(command: Array, a: Array, channel: int) -> float:
    """The correlation in ``channel``, √(Σ|S_ua|²/S_uu / ΣS_aa) over the command's band.

    The slow part of a motion tells the axis: faster, a nozzle may rack more than it moves.
    Raises IdentificationError if it is of another channel, or poor.
    """
    low, high = _band(command, (0.005, 0.995))
    options = {"fs": RATE, "nperseg": min(SEGMENT, len(command)), "detrend": False}
    hz, sent = welch(command, **options)
    heard = welch(a, axis=0, **options)[1]
    cross = np.abs(csd(command[:, None], a, axis=0, **options)[1]) ** 2
    slow = hz <= SLOW_HZ
    if sent[slow].sum() > LEAST_LOW * sent.sum():
        shares = cross[slow].sum(axis=0)
        other = int(np.argmax(shares))
        if shares[other] > OTHER_AXIS**2 * shares[channel]:
            raise IdentificationError(
                f"the recording follows the command in {AXES[other]}, not in {AXES[channel]}: the "
                "axis map is wrong, or the recording is that of another sweep or sensor"
            )
    band = (hz >= low - RATE / SEGMENT) & (hz <= high + RATE / SEGMENT)
    explained = (cross[band, channel] / np.maximum(sent[band], 1e-300)).sum()
    correlation = float(np.sqrt(explained / max(heard[band, channel].sum(), 1e-300)))
    if correlation < POOR:
        raise _unlike()
    return correlation


def _unlike() -> IdentificationError:
    return IdentificationError(
        "the recording does not follow the command: was the sweep played, and is this its "
        "recording, whole and of this sensor?"
    )
