"""A resonance test found in its recording: its true parameters, its start and the clock's drift.

The pulses draw a line into the spectrogram. On a sensor's clock that is fast by
d its slope is hz_per_sec / (1 + d)². Then the motion itself is compared with the recording at low
frequencies, where a printer still follows its motors: this gives the first frequency, the kind
of pulses, the start, and the levels of pulses and sweeping.

A chirp's frequency grows along f = slope·(t − origin), and its harmonics at 3f and 5f share the
origin. Each frequency's power is divided by its median over time: that removes stationary noise,
such as fans, and lets a printer's resonances count no more than other frequencies.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.fft import next_fast_len, rfft, rfftfreq
from scipy.ndimage import gaussian_filter1d, uniform_filter1d
from scipy.signal import fftconvolve
from scipy.signal.windows import hann

from hframe_post.arrays import TS, Array
from hframe_post.errors import IdentificationError
from hframe_post.identification.recordings.accelerometer import PLAUSIBLE, Recording
from hframe_post.identification.recordings.resonance_test import (
    DEFAULTS,
    FORMER_MAX_FREQ,
    ResonanceTest,
)

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
FITS = 4


@dataclass(frozen=True, slots=True)
class ChirpLine:
    """A line f = slope·(t − origin), in Hz, Hz/s and s from the first sample of the recording.

    first, last: frequencies between which it is clearly seen, Hz. score: how far it stands out
    from the rest of the recording; 0.2 or less without a chirp, 2 or more with a whole one.
    """

    slope: float
    origin: float
    first: float
    last: float
    score: float


def find_line(a: Array, rate: float) -> ChirpLine:
    """Return the brightest line in a signal (n, k) with ``rate`` samples a second."""
    size, hop = round(FRAME * rate), round(HOP * rate)
    if len(a) < 4 * size:
        return ChirpLine(1.0, 0.0, 0.0, 0.0, 0.0)
    frames = sliding_window_view(a, size, axis=0)[::hop] * hann(size, sym=False)
    power = (np.abs(rfft(frames, axis=-1)) ** 2).sum(axis=1).T
    hz = rfftfreq(size, 1.0 / rate)
    inside = (hz >= LINE_HZ[0]) & (hz <= LINE_HZ[1])
    hz, power = hz[inside], power[inside]
    floor = 1e-9 * float(power.max()) + 1e-300
    contrast = power / np.maximum(np.median(power, axis=1, keepdims=True), floor)
    score, slope, origin = _brightest(hz, contrast)
    t = (np.arange(power.shape[1]) * hop + size / 2.0) / rate
    origin += t[0]
    line = ChirpLine(slope, origin, 0.0, 0.0, score)
    for _ in range(FITS):
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
    weight = np.ones(len(fit))
    columns = np.column_stack([fit[:, 0], np.ones(len(fit))])
    slope, offset = line.slope, -line.slope * line.origin
    for _ in range(20):
        slope, offset = np.linalg.lstsq(columns * weight[:, None], fit[:, 1] * weight, rcond=None)[
            0
        ]
        miss = fit[:, 1] - columns @ (slope, offset)
        weight = 1.0 / np.hypot(1.0, miss / (1.5 * np.median(np.abs(miss)) + 1e-9))
    if not SLOPES[0] < slope < SLOPES[1]:
        return line
    first, last = (float(f) for f in clear[[0, -1], 2])
    return ChirpLine(float(slope), float(-offset / slope), first, last, line.score)


RATE = 500.0  # samples a second of a recording that is searched
SMOOTHING = 9.0  # ms, of motions before they are compared
STEP = 5  # ms between their samples
START_REACH = 16  # steps by which the start may be off the line's
ALIKE = (
    0.01  # of the share explained, by which the first frequency expected may fall behind another
)
LEAD = 11  # steps of rest before a motion


@dataclass(frozen=True, slots=True)
class Match:
    """A test compared with a recording.

    start: s on the command's clock; like: share explained; pulses, sweeping: responses to
    accelerations of 1, (1,), along the direction in which the recording is strongest, axis (3,).
    """

    test: ResonanceTest
    start: float
    like: float
    pulses: Array
    sweeping: Array
    axis: Array


def low_part(a: Array, drift: float) -> Array:
    """Return the slow part of a recording every ``STEP`` ms of the command's clock."""
    smooth = gaussian_filter1d(a, SMOOTHING * TS * RATE, axis=0)
    t = np.arange(len(a)) / RATE / (1.0 + drift)
    at = np.arange(int(t[-1] / (STEP * TS))) * STEP * TS
    return np.column_stack([np.interp(at, t, column) for column in smooth.T])


def best_match(
    low: Array, known: ResonanceTest, line: ChirpLine, drift: float, high: float
) -> Match:
    """Return the best comparison among all first frequencies and kinds of pulses."""
    origin = line.origin / (1.0 + drift)
    earliest = -known.hz_per_sec * origin - 0.5 * known.hz_per_sec
    latest = line.first * (1.0 + drift) + 1.0
    usual = np.arange(1.0, 300.0, 0.5)
    starts = [known.min_freq, *usual[usual != known.min_freq].tolist()]
    starts = [f for f in starts if max(earliest, 1.0) <= f <= latest]
    if not starts:
        raise cut_at_start(line, known.min_freq)
    seconds = high / known.hz_per_sec + origin
    low, axis = _strongest(low[: max(int(seconds / (STEP * TS)), 1)])
    hz = np.maximum((np.arange(len(low)) * STEP * TS - origin) * known.hz_per_sec, latest - 1.0)
    kinds = [False] if known.sweeping_period else [False, True]
    unit = replace(known, accel_per_hz=1.0, sweeping_accel=1.0)
    fits = [
        _compared(low, axis, 1.0 / hz, replace(unit, min_freq=f, around_point=kind),
                  f / known.hz_per_sec + origin)
        for f, kind in product(starts, kinds)
    ]  # fmt: skip
    most = max(fit.like for fit in fits)
    good = [fit for fit in fits if fit.like >= most - ALIKE]
    return max(good, key=lambda fit: (fit.test.min_freq == known.min_freq, fit.like))


def _strongest(a: Array) -> tuple[Array, Array]:
    """Return the component (n, 1) of a signal (n, 3) along its strongest direction, and that (3,).

    The motion has one direction, noise has three.
    """
    centred = a - a.mean(axis=0)
    axis = np.linalg.eigh(centred.T @ centred)[1][:, -1:]
    return np.asarray(centred @ axis), np.asarray(axis[:, 0])


def _compared(low: Array, axis: Array, weight: Array, test: ResonanceTest, start: float) -> Match:
    """Return the comparison at the best start near the one given, in s."""
    n, first = len(low), round(start / (STEP * TS))
    parts = [_slow(test.pulses())]
    if test.sweeping_period:
        parts.append(_slow(test.sweeping()))
    margin = n + START_REACH + LEAD
    least = margin - first + LEAD - START_REACH
    views = [
        sliding_window_view(np.pad(part, margin)[least : least + n + 2 * START_REACH], n)[::-1]
        for part in parts
    ]
    columns = np.stack([*views, np.ones_like(views[0])], axis=2) * weight[:, None]
    wanted = low * weight[:, None]
    transposed = columns.transpose(0, 2, 1)
    solved = np.linalg.solve(transposed @ columns, transposed @ wanted)
    left = np.square(wanted - columns @ solved).sum(axis=(1, 2))
    offset = weight[:, None] * np.linalg.lstsq(weight[:, None], wanted, rcond=None)[0]
    like = 1.0 - left / float(np.square(wanted - offset).sum())
    k = int(np.argmax(like))
    late, top = float(k - START_REACH), float(like[k])
    if 0 < k < len(like) - 1:  # the summit of a parabola
        before, after = like[k - 1], like[k + 1]
        by = 0.5 * float((before - after) / (before - 2.0 * top + after))
        late, top = late + by, top - 0.25 * float(before - after) * by
    sweeping = solved[k, 1] if test.sweeping_period else np.zeros(1)
    return Match(test, (first + late) * STEP * TS, top, solved[k, 0], sweeping, axis)


def _slow(displacement: Array) -> Array:
    """Return the slow part of an acceleration, every ``STEP`` ms from ``LEAD`` steps before it."""
    padded = np.pad(displacement, (LEAD * STEP, 0), mode="edge")
    acceleration = np.diff(padded, 2, prepend=padded[0], append=padded[-1]) / TS**2
    return np.asarray(gaussian_filter1d(acceleration, SMOOTHING)[::STEP])


def cut_at_start(line: ChirpLine, expected: float) -> IdentificationError:
    """Return the error for a recording that lacks the beginning of the test."""
    begins = -line.slope * line.origin
    return IdentificationError(
        f"the recording begins in the middle of the resonance test, at {begins:.0f} Hz: it was cut "
        f"(use the whole file), or min_freq was not {expected:g} as in [resonance_tester]: set it "
        "as it was in the test"
    )


LEAST_LIKE = 0.6  # share of the recording at low frequencies that the motion explains
LEAST_GROWTH = -0.5  # of the level at low frequencies, as a power of the frequency: sines have -1
LEAST_MOVED = 0.2  # of the level expected: sensors and settings differ less
LEAST_PEAK = 1.5  # of the level; with shaping 1.2, without 2.9 and more on 20 drawn printers
REST = 0.05  # s before the motion that a whole recording has
ELSEWHERE = (
    "the sensor did not move with this axis (it sat on the frame, on another head, or on the head "
    "while the bed moves, or the other way round)"
)


def rests_before(a: Array, start: float) -> bool:
    """Return whether the printer of a recording rests before a motion that starts at s."""
    first = int((start - REST) * RATE)
    moving = float(a[max(first, 0) :][: int(RATE)].std(axis=0).max())
    return first > 0 and float(a[:first].std(axis=0).max()) < 0.5 * moving


def check_motion(fit: Match, line: ChirpLine, hz: Array, level: Array) -> None:
    """Raise IdentificationError if what a recording shows at low frequencies is another motion."""
    grows = f"the recording's frequency grows by {line.slope:.3g} Hz/s as in a resonance test, but"
    if float(np.polyfit(np.log(hz), np.log(level), 1)[0]) < LEAST_GROWTH:
        raise IdentificationError(
            f"{grows} its acceleration does not grow with it: this is another program's sweep"
        )
    if fit.like < LEAST_LIKE:
        raise IdentificationError(
            f"{grows} only {100.0 * max(fit.like, 0.0):.0f} % of what it shows below "
            f"{hz[-1]:.0f} Hz is that motion. Either {ELSEWHERE}, or input shaping was on "
            "(INPUT_SHAPING=1), or another program made it"
        )


def check_level(fit: Match, level: float, expected: ResonanceTest) -> None:
    """Raise IdentificationError if the sensor moved far less than the axis did.

    A test of weak pulses still has its sweeping in full.
    """
    share = level / expected.accel_per_hz
    sweeps = bool(fit.test.sweeping_period)
    if share >= LEAST_MOVED:
        return
    if sweeps and np.linalg.norm(fit.sweeping) > 2.0 * LEAST_MOVED * expected.sweeping_accel:
        return
    cause = ELSEWHERE
    if not sweeps and level > 1.0:
        cause = (
            f"either {ELSEWHERE}, or the test was run with ACCEL_PER_HZ={level:.2g}: set "
            f"accel_per_hz in [resonance_tester], which is {expected.accel_per_hz:g}"
        )
    raise IdentificationError(
        f"the recording shows {100.0 * share:.0f} % of the acceleration that the test makes: "
        f"{cause}"
    )


def check_shaping(hz: Array, level: Array, base: float) -> None:
    """Raise IdentificationError if a printer that falls behind its motors resonates nowhere."""
    if level.max() < LEAST_PEAK * base and level.min() < 0.5 * base:
        fades = float(hz[np.flatnonzero(level < 0.5 * base)[0]])
        raise IdentificationError(
            f"the recording shows no resonance, and from {fades:.0f} Hz on less than half of the "
            "test's motion. Either input shaping was on (repeat TEST_RESONANCES without "
            "INPUT_SHAPING=1), or something soft lies between motors and sensor, such as a slack "
            "belt or a sensor that is not screwed on"
        )


LEAST_SCORE = 0.3  # of a line
MOST_DRIFT = 0.03
USUAL_RATES = (1.0, 0.5, 2.0, 0.25, 0.2, 0.1, 1.5, 0.75, 3.0, 4.0, 5.0)  # Hz/s
LOW_HZ = 20.0  # to which motions are compared, unless the printer resonates earlier
RISE = 1.4  # of the level, where that is
PERIODS = (0.3, 4.0)  # s, of sweeping
LEAST_SWEEPING = 30.0  # mm/s²
SAME_LEVEL = 0.2  # by which sensors and printers may differ from the level expected
END = 0.15  # s over which the end of the pulses is looked for
SOON = 1.0  # s from the motion's end to that of a recording


@dataclass(frozen=True, slots=True)
class Found:
    """What a recording shows of a resonance test.

    test: the motion that was played; start: s on the sensor's clock at the first moment of the
    motion, within 5 ms, the printer's delay included; drift: by how much that clock runs fast,
    within 0.05 %. axis (3,): unit vector of the sensor's slow motion.
    """

    test: ResonanceTest
    start: float
    drift: float
    axis: Array


def find(recording: Recording, expected: ResonanceTest) -> Found:
    """Return the resonance test in a recording, which printer.cfg describes as ``expected``.

    Raises IdentificationError if there is none, if a part is missing, or if the recording does not
    show its motion.
    """
    try:
        return _found(recording, expected)
    except IdentificationError as error:
        gravity = float(np.linalg.norm(recording.a.mean(axis=0)))
        if PLAUSIBLE[0] <= gravity <= PLAUSIBLE[1]:
            raise
        raise IdentificationError(
            f"on average the sensor shows {gravity:.3g} mm/s² instead of gravity, 9810: check its "
            f"unit and range. {str(error)[0].upper()}{str(error)[1:]}"
        ) from None


def _found(recording: Recording, expected: ResonanceTest) -> Found:
    a = _uniform(recording)
    line = find_line(a, RATE)
    if line.score < LEAST_SCORE or line.last - line.first < 5.0:
        raise IdentificationError(
            "the recording shows no resonance test, whose frequency grows steadily. If it is of "
            "a sweep, put the CSV file that 'hframe-post measure' wrote next to it"
        )
    hz_per_sec, drift = _rate(line.slope, expected.hz_per_sec)
    hz, level = _levels(a, line)
    low, high = _low_band(hz, level)
    known = replace(_swept(a, expected, drift), hz_per_sec=hz_per_sec, max_freq=high + 2.0)
    fit = best_match(low_part(a, drift), known, line, drift, high)
    check_level(fit, low, expected)
    slow = hz <= high
    if fit.test.min_freq != expected.min_freq and not rests_before(a, fit.start * (1.0 + drift)):
        if -line.slope * line.origin < expected.min_freq + SOON * line.slope:
            check_motion(fit, line, hz[slow], level[slow])  # else nothing is missing
        raise cut_at_start(line, expected.min_freq)
    check_motion(fit, line, hz[slow], level[slow])
    last = _last_hz(a, line, drift, fit, expected)
    check_shaping(hz, level, low)
    test = _with_levels(fit, low / (1.0 + drift), expected)
    start = float(recording.t[0] + fit.start * (1.0 + drift))
    return Found(replace(test, max_freq=last), start, drift, fit.axis)


def _uniform(recording: Recording) -> Array:
    """Return accelerations (n, 3) without gravity, ``RATE`` samples a second."""
    t = recording.t - recording.t[0]
    at = np.arange(int(t[-1] * RATE)) / RATE
    smooth = uniform_filter1d(recording.a, max(1, round(1.0 / RATE / recording.period)), axis=0)
    a = np.column_stack([np.interp(at, t, column) for column in smooth.T])
    return np.asarray(a - a.mean(axis=0))


def _rate(slope: float, expected: float) -> tuple[float, float]:
    """Return hz_per_sec and the drift of the clock on which a line has a slope in Hz/s."""
    for rate in (expected, *USUAL_RATES):
        drift = float(np.sqrt(rate / slope)) - 1.0
        if abs(drift) < MOST_DRIFT:
            return rate, drift
    raise IdentificationError(
        f"the recording's frequency grows by {slope:.3g} Hz/s, not by hz_per_sec "
        f"{expected:g}. Set it in [resonance_tester] as it was in the test; if it was {expected:g},"
        " the file's time is not in seconds"
    )


def _along_line(a: Array, line: ChirpLine, seconds: float) -> tuple[Array, Array]:
    """Return, at each sample, the line's frequency in Hz and the response's size there, (n,) each.

    seconds: over which the size is averaged.
    """
    since = np.arange(len(a)) / RATE - line.origin
    turning = np.exp(-1j * np.pi * line.slope * np.square(since))
    window = hann(round(seconds * RATE))[:, None]
    size = np.linalg.norm(fftconvolve(a * turning[:, None], window / window.sum(), "same"), axis=1)
    return line.slope * since, size


def _levels(a: Array, line: ChirpLine) -> tuple[Array, Array]:
    """Return frequencies (k,) and the responses (k,) to pulses there, mm/s² per Hz."""
    hz, size = _along_line(a, line, 1.0)
    keep = (hz >= line.first + 0.5) & (hz <= line.last - 0.5)
    # a square wave's fundamental is 4/π times as large, half of it at positive frequencies
    return hz[keep][::25], (size[keep] / hz[keep])[::25] * np.pi / 2.0


def _low_band(hz: Array, level: Array) -> tuple[float, float]:
    """Return the level at 0 Hz and the frequency up to which a printer follows its motors."""
    base = float(np.median(level[hz < hz[0] + 5.0]))
    risen = np.flatnonzero(level > RISE * base)
    edge = max(float(hz[risen[0]]) if risen.size else LOW_HZ, hz[0] + 4.0)
    low = hz <= edge
    # below a mode at f₀ the level is that at 0 Hz / (1 − (f/f₀)²); other modes are outliers
    columns = np.column_stack([np.ones(int(low.sum())), -np.square(hz[low])])
    wanted, weight = 1.0 / level[low], np.ones(int(low.sum()))
    for _ in range(20):
        fit = np.linalg.lstsq(columns * weight[:, None], wanted * weight, rcond=None)[0]
        miss = np.abs(wanted - columns @ fit)
        weight = 1.0 / np.sqrt(miss + 0.01 * np.median(miss) + 1e-12)
    return (1.0 / float(fit[0]) if fit.min() > 0.0 else base), min(edge, max(LOW_HZ, hz[0] + 8.0))


def _swept(a: Array, expected: ResonanceTest, drift: float) -> ResonanceTest:
    """Return the test with the period of sweeping that a recording shows, 0 if there is none."""
    size = next_fast_len(4 * len(a), real=True)
    hz = rfftfreq(size, 1.0 / RATE) * (1.0 + drift)
    inside = (hz > 1.0 / PERIODS[1]) & (hz < 1.0 / PERIODS[0])
    wave = np.linalg.norm(np.abs(rfft(a * hann(len(a))[:, None], size, axis=0))[inside], axis=1)
    wave *= 4.0 / len(a) * np.pi / 4.0
    at = int(np.argmax(wave))
    if wave[at] < max(LEAST_SWEEPING, 10.0 * float(np.median(wave))):
        return replace(expected, sweeping_period=0.0)
    period = 1.0 / float(hz[inside][at])
    usual = (p for p in (expected.sweeping_period, 1.2) if abs(period - p) < 0.02 * period)
    return replace(expected, sweeping_period=next(usual, round(period, 2)))


def _last_hz(a: Array, line: ChirpLine, drift: float, fit: Match, expected: ResonanceTest) -> float:
    """Return the frequency at which the pulses end; raises IdentificationError if cut off."""
    hz, size = _along_line(a, line, END)
    before = (hz > line.last - 2.0 * line.slope) & (hz < line.last - line.slope)
    near = before | (hz >= line.last - line.slope) & (hz < line.last + 2.0 * line.slope)
    strong = size > 0.5 * np.median(size[before])
    last = float(hz[near & strong][-1]) * (1.0 + drift)
    end = float(hz[-1]) * (1.0 + drift)
    ended = end - last > END * line.slope
    usual = [expected.max_freq, DEFAULTS["max_freq"], FORMER_MAX_FREQ]
    # the firmware stops recording soon after the motion, which noise may hide before
    recorded = [f for f in [*usual, 5.0 * (end // 5.0)] if last < f <= end < f + SOON * line.slope]
    if ended:
        usual.append(5.0 * round(last / 5.0))
    found = min(usual, key=lambda f: abs(f - last))
    if abs(found - last) < 0.4 * max(1.0, line.slope):
        return found
    if ended and recorded:
        return recorded[0]
    if not ended and 0.0 <= end - expected.max_freq < SOON * line.slope:
        return expected.max_freq  # all of it was recorded; noise hides where it ends
    if not ended:
        raise IdentificationError(
            f"the recording ends in the middle of the resonance test, at {last:.0f} Hz of "
            f"{expected.max_freq:g} Hz: it was cut. Use the whole file"
        )
    return round(last, 1)


def _with_levels(fit: Match, level: float, expected: ResonanceTest) -> ResonanceTest:
    """Return the test with levels from the recording where they are not those expected."""
    swept = float(np.linalg.norm(fit.sweeping))
    sweeping_accel, gain = expected.sweeping_accel, 1.0
    if fit.test.sweeping_period:
        sweeping_accel = _usual(swept, (sweeping_accel, 400.0, 200.0), 10.0)
        gain = swept / sweeping_accel
    accel_per_hz = _usual(level / gain, (expected.accel_per_hz, 60.0, 75.0), 1.0)
    return replace(fit.test, accel_per_hz=accel_per_hz, sweeping_accel=sweeping_accel)


def _usual(found: float, usual: tuple[float, ...], step: float) -> float:
    """Return the expected, first value if it is near enough, another if nearer, or a round one."""
    for value, tolerance in zip(usual, (SAME_LEVEL, 0.1, 0.1), strict=True):
        if abs(found / value - 1.0) < tolerance:
            return value
    return max(step, step * round(found / step))
