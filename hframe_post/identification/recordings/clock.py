"""When a recording began, and how fast its clock runs: one estimation, with what is known before.

A sensor's clock starts elsewhere and runs at another rate: it shows start + (1 + drift)·t at t of
the command (``Clock``). What is known of it beforehand is of three kinds:

===================  =======================  =======================================
motion               start                    drift
===================  =======================  =======================================
strokes              by the printer's clock   0: Klipper's samples have its print time
TEST_RESONANCES      within some ms           within 0.06 %
Marlin's sweep       not known                within 3 %
===================  =======================  =======================================

**Known.** The start of a command on Klipper's clock is the time in the recording's name, at which
the motion had ended, less the command's duration; without it, half a sample before the first one,
since Klipper keeps the samples from the first call of ACCELEROMETER_MEASURE on. Nothing is left to
estimate, but each part must follow the command in time, or the motion stopped in between.

**Unknown.** The frequency of such motions grows steadily. It draws a line f = slope·(t − origin)
into the spectrograms of command and recording, and its harmonics at 3f and 5f share the origin.
Each frequency's power is divided by its median over time: that removes stationary noise, such as
fans, and lets a printer's resonances count no more than other frequencies. Slopes and origins of
the two lines show start and rate, to some ms. Then the rate is refined: the same frequency is
excited at several times, by the sine, by its harmonics and by slow motion beneath it, and on the
right clock all of them have one phase, so that the command explains most of the recording. The rest
of the start is a delay of the response.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.fft import irfft, rfft, rfftfreq
from scipy.interpolate import BSpline, make_interp_spline
from scipy.ndimage import uniform_filter1d
from scipy.signal import fftconvolve, firwin, upfirdn
from scipy.signal.windows import hann

from hframe_post.arrays import TS, Array, Integers
from hframe_post.errors import IdentificationError
from hframe_post.identification import verdict
from hframe_post.identification.recordings.accelerometer import Recording, robust_fit


def acceleration(position: Array) -> Array:
    """Return the second derivative, mm/s², of positions (m,) or (m, k) in mm every 1 ms.

    It is that of a spline, with a gain within 1e-5 up to 100 Hz; the second difference would be
    2 % low at 80 Hz. Before and after, the position rests where it begins and ends: at the ends of
    its samples alone a spline is free to turn as steeply as it likes. Raises IdentificationError
    for fewer samples than a spline needs.
    """
    degree = 7
    if len(position) <= degree:
        raise IdentificationError(f"a command of {len(position)} ms is too short to be a motion")
    rest = 2 * degree  # samples; a spline feels none farther away
    ends = [(rest, rest), (0, 0)][: position.ndim]
    resting = np.pad(position - position[0], ends, mode="edge")
    k = np.arange(len(resting), dtype=np.float64)
    spline = make_interp_spline(k, resting, degree)
    return np.asarray(spline.derivative(2)(k[rest:-rest]) / TS**2)


@dataclass(frozen=True, slots=True)
class Clock:
    """A sensor's clock.

    start: s on it at the first row of the command. drift: by how much it runs fast. is_exact:
    whether the printer's own clock reports the start.
    """

    start: float
    drift: float = 0.0
    is_exact: bool = False

    def at(self, rows: Array | Integers) -> Array:
        """Return what it shows at rows (k,) of the command, s."""
        return np.asarray(self.start + (1.0 + self.drift) * TS * rows)


class Resampler:
    """Samples a (n, 3) at rising times t (n,) in s, as a function of time."""

    def __init__(self, t: Array, a: Array) -> None:
        self._first, self._last = float(t[0]), float(t[-1])
        self._spline: BSpline = make_interp_spline(t - t[0], a, 5)
        self._factor = int(np.ceil(TS / float(np.median(np.diff(t)))))

    def resampled(self, clock: Clock, m: int) -> Array:
        """Return accelerations (m, 3) every 1 ms of the command, without aliases.

        Interpolates at a multiple of 1 kHz not below the sensor's rate, then decimates with
        linear phase: flat to 250 Hz, −80 dB from 750 Hz. Outside the recording its first and
        last samples continue.
        """
        factor = self._factor
        half = 6 * factor  # of the filter's length: 6 ms
        k = np.arange(-half, (m - 1) * factor + half + 1)
        shown = np.clip(clock.at(k / factor), self._first, self._last)
        values = self._spline(shown - self._first)
        if factor == 1:
            return np.asarray(values[half : half + m])
        taps = firwin(2 * half + 1, 500.0, window=("kaiser", 8.0), fs=factor / TS)
        first = 2 * half // factor
        return np.asarray(upfirdn(taps, values, 1, factor, axis=0)[first : first + m])

    def recorded(self, shown: Array) -> Array:
        """Return whether the recording covers times of its clock."""
        return np.asarray((shown >= self._first) & (shown <= self._last))


# ---------------------------------------------------------------------- a line in a spectrogram

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


# ---------------------------------------------------------------------- one estimation

SEGMENT = 2000  # samples, of the spectra that are compared over time
CLOCK_BAND_HZ = (4.0, 100.0)
WITHIN = (9e-3, 6e-4)  # by which the rate may be off: by a line, by a test or the step before


@dataclass(frozen=True, slots=True)
class Aligned:
    """A recording on the clock of its command, in the sensor's axes.

    command (n, k): accelerations of the directions that move; acceleration (n, 3): mm/s² every
    1 ms, both 0 where nothing was recorded. Gravity and offset are removed, the sensor's gains are
    not. The band is that of the sensor: up to 250 Hz of 3200 samples a second.
    """

    command: Array
    acceleration: Array
    clock: Clock


def aligned(command: Array, recording: Recording, known: Clock | None = None) -> Aligned:
    """Return the recording on the clock of a command (m, k), accelerations in mm/s².

    recording: in any axes, also left-handed ones. known: the clock, exactly if its start is
    reported, else to 20 ms over the recording. Raises IdentificationError if the recording does not
    contain the command.
    """
    size = np.abs(command).max(axis=1)
    moving = np.flatnonzero(size > 1e-3 * size.max(initial=0.0))
    if not moving.size:
        raise IdentificationError("the command does not move")
    clock = known or _by_chirp(command, recording)
    begins, ends = clock.at(moving[[0, -1]]).tolist()
    # strokes begin at rest; half of that, in case the start is late
    resting = recording.t <= (recording.t[0] + begins) / 2.0
    offset = recording.a[resting] if clock.is_exact and resting.any() else recording.a
    sensor = Resampler(recording.t, recording.a - offset.mean(axis=0))
    verdict.check_covers(float(recording.t[0]) - begins, ends - float(recording.t[-1]))
    middle, explained = TS * float(moving.mean()), 1.0
    for within in () if clock.is_exact else WITHIN[1:] if known else WITHIN:
        by, explained = _refined(command[:, 0], sensor.resampled(clock, len(command)), within)
        start = clock.start if known else clock.start - by * middle
        clock = Clock(start, clock.drift + by)
    verdict.check_follows(explained)
    verdict.check_drift(clock.drift)
    # a test ends while the printer still rings: of an SV08's gain that is 1 %, of Marlin's mode 3 %
    whole = np.pad(command, ((0, 0 if clock.is_exact else 1000), (0, 0)))
    recorded = sensor.recorded(clock.at(np.arange(len(whole))))[:, None]
    found = Aligned(whole * recorded, sensor.resampled(clock, len(whole)) * recorded, clock)
    if clock.is_exact:
        _check_in_time(slow_part(found.command), slow_part(found.acceleration))
    return found


def _by_chirp(command: Array, recording: Recording) -> Clock:
    """Return the clock on which the lines of a command (m, 1) and its recording are one."""
    sent = find_line(command)
    shown = find_line(uniform(recording.t, recording.a))
    if sent is None or shown is None:
        return Clock(float(recording.t[0]))
    (t_sent, hz_sent), (t, hz), rate = sent.seen.T, shown.seen.T, 1.0
    for _ in range(3):  # a fast clock shows lower frequencies, too
        at = np.interp(hz * rate, np.maximum.accumulate(hz_sent), t_sent)
        by, start = robust_fit(np.column_stack([at, np.ones(len(at))]), t).tolist()
        rate = float(np.sqrt(rate * by))
    return Clock(float(recording.t[0]) + start, rate - 1.0)


def _refined(command: Array, acceleration: Array, reach: float) -> tuple[float, float]:
    """Return the drift within ±reach with which the command explains most, and what it explains.

    Spectra of short pieces are turned in phase as a drift would delay them. The second is a share
    of the recording's power, of pieces that were not fitted: of n independent ones that were, any
    command explains 1/n more.
    """
    taper = np.hanning(SEGMENT)
    starts = np.arange(0, len(command) - SEGMENT + 1, SEGMENT // 4)
    pieces = starts[:, None] + np.arange(SEGMENT)
    hz = rfftfreq(SEGMENT, TS)
    inside = (hz >= CLOCK_BAND_HZ[0]) & (hz <= CLOCK_BAND_HZ[1])
    U = rfft(command[pieces] * taper, axis=1)[:, inside]
    pieces_a = acceleration[pieces]
    pieces_a = (pieces_a - pieces_a.mean(axis=1, keepdims=True)) * taper[:, None]
    A = rfft(pieces_a, axis=1)[:, inside]
    cross = U.conj()[:, :, None] * A  # (pieces, frequencies, 3)
    sent = np.maximum((np.abs(U) ** 2).sum(axis=0), 1e-300)
    received = np.maximum((np.abs(A) ** 2).sum(axis=(0, 2)), 1e-300)
    turn = 2.0 * np.pi * np.outer((starts + SEGMENT / 2.0) * TS, hz[inside])
    drifts = np.linspace(-reach, reach, 81)
    phase, step = np.exp(1j * turn * drifts[0]), np.exp(1j * turn * (drifts[1] - drifts[0]))
    explained, shares = [], []
    for _ in drifts:
        power = (np.abs(np.einsum("tf,tfc->fc", phase, cross)) ** 2).sum(axis=1) / sent
        explained.append(-np.log(np.maximum(1.0 - power / received, 1e-6)).sum())
        shares.append(float(power.sum() / received.sum()))
        phase *= step
    at, share = summit(np.array(explained)), shares[int(np.argmax(explained))]
    n = 1.0 + 2.08 * (len(command) / SEGMENT - 1.0)  # by the bandwidth of a Hann window
    unseen = (n * share - 1.0) / (n - 1.0) if n > 1.0 else 0.0
    return float(np.interp(at, np.arange(len(drifts)), drifts)), unseen


def summit(values: Array) -> float:
    """Return where values (k,) at 0, 1, 2, … are greatest: the summit of a parabola."""
    k = int(np.clip(np.argmax(values), 1, len(values) - 2))
    before, at, after = values[k - 1 : k + 2].tolist()
    return (
        k + float(np.clip((before - after) / min(before - 2.0 * at + after, -1e-300), -2, 2)) / 2.0
    )


# ---------------------------------------------------------------------- reported by the printer

AGREED = 1e-3  # s by which the two starts may differ, beyond the time between samples
SHORTEST_STOP = 0.1  # s by which Klipper moves the print time at least, once its queue is empty
SLOW_HZ = (2.0, 10.0)
PART, LAG_REACH = 8000, 2000  # samples of a part that must follow in time, and of its search


def known_start(
    recording: Recording, samples: int, ended: float | None
) -> tuple[Clock, tuple[str, ...]]:
    """Return the clock of a command of that many samples, and what was unusual about its start.

    ended: print time in s at which the motion had ended, if the recording's name tells. Raises
    IdentificationError if nothing tells.
    """
    first = Clock(float(recording.t[0]) - recording.period / 2.0, is_exact=True)
    if ended is None and not recording.started:
        raise IdentificationError(
            "nothing tells when its motion began. Let Klipper record it, by the file of "
            "'hframe-post measure'"
        )
    if ended is None:
        return first, ()
    named = Clock(ended - (samples - 1) * TS, is_exact=True)
    off = abs(named.start - first.start)
    missed = off - recording.period / 2.0
    if not recording.started or missed <= AGREED:
        return named, ()
    differ = f"the time in its name and its first sample differ by {1e3 * off:.3g} ms"
    if missed <= SHORTEST_STOP:  # its time stamps wander, or the host was late
        late = "x, y and racking may be late relative to each other by as much"
        return named, (f"{differ}: {late}",)
    # another command has moved the print time after the motion; or the motion stopped, which shows
    return first, (f"{differ}: the sample counts",)


def slow_part(values: Array, band_hz: tuple[float, float] = SLOW_HZ) -> Array:
    """Return the part of values (n, k), one a millisecond, that lies in a band."""
    hz = rfftfreq(len(values), TS)
    spectra = rfft(values, axis=0)
    spectra[(hz < band_hz[0]) | (hz > band_hz[1])] = 0.0
    return np.asarray(irfft(spectra, len(values), axis=0))


def _check_in_time(slow: Array, shown: Array) -> None:
    """Raise IdentificationError unless each part of a recording follows its command.

    slow (m, k), shown (m, 3): slow parts of the command's acceleration and of the recording.
    """
    for first in range(0, len(slow) - PART // 2, PART):
        part, low = slow[first : first + PART], max(first - LAG_REACH, 0)
        share, _ = follows(part, shown[low : first + len(part) + LAG_REACH])
        lag = (low + int(np.argmax(share)) - first) * TS
        verdict.check_follows(float(share.max()))
        if abs(lag) <= verdict.LAG_S:
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


def follows(u: Array, shown: Array) -> tuple[Array, Array]:
    """Return how a motion u (n, k) is in what a sensor shows (m, j), for each lag of m − n + 1.

    That is the share of the shown part that u explains by least squares, (lags,), and the sizes
    with which it does so, (lags, k, j).
    """
    products = np.stack([[fftconvolve(a, part, "valid") for a in shown.T] for part in u[::-1].T])
    sizes = np.moveaxis(np.tensordot(np.linalg.pinv(u.T @ u, 1e-9), products, 1), -1, 0)
    summed = np.cumsum(np.pad(np.square(shown).sum(axis=1), (1, 0)))
    energy = summed[len(u) :] - summed[: -len(u)]
    explained = (sizes * np.moveaxis(products, -1, 0)).sum(axis=(1, 2))
    return explained / np.maximum(energy, 1e-300), sizes
