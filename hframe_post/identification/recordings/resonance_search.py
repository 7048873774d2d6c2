"""A resonance test found in its recording: its true parameters, its start and the clock's drift.

The pulses draw a line into the spectrogram (``chirp``). On a sensor's clock that is fast by
d its slope is hz_per_sec / (1 + d)². Then the motion itself is compared with the recording at low
frequencies, where a printer still follows its motors: this gives the first frequency, the kind
of pulses, the start, and the levels of pulses and sweeping.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.fft import next_fast_len, rfft, rfftfreq
from scipy.ndimage import gaussian_filter1d
from scipy.signal import fftconvolve
from scipy.signal.windows import hann

from hframe_post.arrays import TS, Array
from hframe_post.errors import IdentificationError
from hframe_post.identification import verdict
from hframe_post.identification.recordings.accelerometer import Recording
from hframe_post.identification.recordings.chirp import (
    RATE,
    ChirpLine,
    find_line,
    robust_fit,
    uniform,
)
from hframe_post.identification.recordings.clock import Clock
from hframe_post.identification.recordings.resonance_test import (
    DEFAULTS,
    FORMER_MAX_FREQ,
    ResonanceTest,
)

SMOOTHING = 9.0  # ms, of motions before they are compared
STEP = 5  # ms between their samples
START_REACH = 16  # steps by which the start may be off the line's
# of the share explained, by which the first frequency expected may fall behind another
ALIKE = 0.01
LEAD = 11  # steps of rest before a motion


@dataclass(frozen=True, slots=True)
class Match:
    """A test compared with a recording.

    start: s on the command's clock; like: share explained; sweeping: size of the response to a
    sweeping of 1, along the direction in which the recording is strongest, axis (3,).
    """

    test: ResonanceTest
    start: float
    like: float
    sweeping: float
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
    """Return the component (n,) of a signal (n, 3) along its strongest direction, and that (3,).

    The motion has one direction, noise has three.
    """
    centred = a - a.mean(axis=0)
    axis = np.linalg.eigh(centred.T @ centred)[1][:, -1]
    return np.asarray(centred @ axis), np.asarray(axis)


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
    wanted = low * weight
    transposed = columns.transpose(0, 2, 1)
    solved = np.linalg.solve(transposed @ columns, (transposed @ wanted)[:, :, None])
    left = np.square(wanted - (columns @ solved)[:, :, 0]).sum(axis=1)
    still = wanted - weight * (weight @ wanted) / (weight @ weight)
    like = 1.0 - left / float(still @ still)
    k = int(np.argmax(like))
    late, top = float(k - START_REACH), float(like[k])
    if 0 < k < len(like) - 1:  # the summit of a parabola
        before, after = like[k - 1], like[k + 1]
        by = 0.5 * float((before - after) / (before - 2.0 * top + after))
        late, top = late + by, top - 0.25 * float(before - after) * by
    sweeping = abs(float(solved[k, 1, 0])) if test.sweeping_period else 0.0
    return Match(test, (first + late) * STEP * TS, top, sweeping, axis)


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
    growth = float(np.polyfit(np.log(hz), np.log(level), 1)[0])
    if growth < verdict.TEST_GROWTH:
        raise IdentificationError(
            f"{grows} its acceleration does not grow with it (to its power of {1.0 + growth:.2f}; "
            f"a test to {1.0 + verdict.TEST_GROWTH:g} or more): this is another program's sweep"
        )
    if fit.like < verdict.TEST_EXPLAINED:
        raise IdentificationError(
            f"{grows} only {100.0 * max(fit.like, 0.0):.0f} % of what it shows below "
            f"{hz[-1]:.0f} Hz is that motion, not {100.0 * verdict.TEST_EXPLAINED:.0f} % or more. "
            f"Either {ELSEWHERE}, or input shaping was on (INPUT_SHAPING=1), or another program "
            "made it"
        )


def check_level(fit: Match, level: float, expected: ResonanceTest) -> None:
    """Raise IdentificationError if the sensor moved far less than the axis did.

    A test of weak pulses still has its sweeping in full.
    """
    share = level / expected.accel_per_hz
    swept = fit.sweeping / expected.sweeping_accel
    if share >= verdict.TEST_LEVEL or swept > 2.0 * verdict.TEST_LEVEL:
        return
    cause = ELSEWHERE
    if not fit.test.sweeping_period and level > 1.0:
        cause = (
            f"either {ELSEWHERE}, or the test was run with ACCEL_PER_HZ={level:.2g}: set "
            f"accel_per_hz in [resonance_tester], which is {expected.accel_per_hz:g}"
        )
    raise IdentificationError(
        f"the recording shows {100.0 * share:.0f} % of the acceleration that the test makes, not "
        f"{100.0 * verdict.TEST_LEVEL:.0f} % or more: {cause}"
    )


def check_shaping(hz: Array, level: Array, base: float) -> None:
    """Raise IdentificationError if a printer that falls behind its motors resonates nowhere."""
    if level.max() < verdict.TEST_PEAK * base and level.min() < 0.5 * base:
        fades = float(hz[np.flatnonzero(level < 0.5 * base)[0]])
        raise IdentificationError(
            f"the recording shows no resonance (at most {level.max() / base:.1f} times its level "
            f"at low frequencies, not {verdict.TEST_PEAK:g}), and from {fades:.0f} Hz on less than "
            "half of the test's motion. Either input shaping was on (repeat TEST_RESONANCES "
            "without INPUT_SHAPING=1), or something soft lies between motors and sensor, such as "
            "a slack belt or a sensor that is not screwed on"
        )


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

    test: the motion that was played. clock: its start within 5 ms, the printer's delay included,
    its drift within 0.05 %. axis (3,): unit vector of the sensor's slow motion.
    """

    test: ResonanceTest
    clock: Clock
    axis: Array


def find(recording: Recording, expected: ResonanceTest) -> Found:
    """Return the resonance test in a recording, which printer.cfg describes as ``expected``.

    Raises IdentificationError if there is none, if a part is missing, or if the recording does not
    show its motion.
    """
    a = uniform(recording.t, recording.a)
    line = find_line(a)
    if not line.clear:
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
    clock = Clock(float(recording.t[0] + fit.start * (1.0 + drift)), drift)
    return Found(replace(test, max_freq=last), clock, fit.axis)


def _rate(slope: float, expected: float) -> tuple[float, float]:
    """Return hz_per_sec and the drift of the clock on which a line has a slope in Hz/s."""
    for rate in (expected, *USUAL_RATES):
        drift = float(np.sqrt(rate / slope)) - 1.0
        if abs(drift) < verdict.CLOCK_DRIFT:
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
    fit = robust_fit(columns, 1.0 / level[low])
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
    near = np.abs(hz - line.last) < 2.0 * line.slope
    strong = size > 0.5 * np.median(size[before])
    last = float(hz[near & strong][-1]) * (1.0 + drift)
    end = float(hz[-1]) * (1.0 + drift)
    ended = end - last > END * line.slope
    usual = [expected.max_freq, DEFAULTS["max_freq"], FORMER_MAX_FREQ]
    rounded = [5.0 * round(last / 5.0)] if ended else []
    found = min([*usual, *rounded], key=lambda f: abs(f - last))
    if abs(found - last) < 0.4 * max(1.0, line.slope):
        return found
    # the firmware stops recording soon after the motion, whose end noise may hide
    usual = [*usual, 5.0 * (end // 5.0)] if ended else usual[:1]
    hidden = [f for f in usual if f <= end < f + SOON * line.slope]
    if not (hidden or ended):
        raise IdentificationError(
            f"the recording ends in the middle of the resonance test, at {last:.0f} Hz of "
            f"{expected.max_freq:g} Hz: it was cut. Use the whole file"
        )
    return hidden[0] if hidden else round(last, 1)


def _with_levels(fit: Match, level: float, expected: ResonanceTest) -> ResonanceTest:
    """Return the test with levels from the recording where they are not those expected."""
    sweeping_accel, gain = expected.sweeping_accel, 1.0
    if fit.test.sweeping_period:
        sweeping_accel = _usual(fit.sweeping, (sweeping_accel, 400.0, 200.0), 10.0)
        gain = fit.sweeping / sweeping_accel
    accel_per_hz = _usual(level / gain, (expected.accel_per_hz, 60.0, 75.0), 1.0)
    return replace(fit.test, accel_per_hz=accel_per_hz, sweeping_accel=sweeping_accel)


def _usual(found: float, usual: tuple[float, ...], step: float) -> float:
    """Return the expected, first value if it is near enough, another if nearer, or a round one."""
    for value, tolerance in zip(usual, (SAME_LEVEL, 0.1, 0.1), strict=True):
        if abs(found / value - 1.0) < tolerance:
            return value
    return max(step, step * round(found / step))
