"""A resonance test found in its recording: its true parameters, its start and the clock's drift.

The pulses draw a line into the spectrogram (``clock``). On a sensor's clock that is fast by
d its slope is hz_per_sec / (1 + d)². Then the motion itself is compared with the recording at low
frequencies, where a printer still follows its motors: this gives the first frequency, the kind
of pulses, the start, and the levels of pulses and sweeping.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.fft import rfft, rfftfreq
from scipy.ndimage import gaussian_filter1d
from scipy.signal import oaconvolve
from scipy.signal.windows import hann

from hframe_post.arrays import TS, Array, Complex
from hframe_post.errors import IdentificationError
from hframe_post.identification import verdict
from hframe_post.identification.recordings.accelerometer import Recording, robust_fit
from hframe_post.identification.recordings.clock import (
    ChirpLine,
    Clock,
    find_line,
    follows,
    summit,
    uniform,
)
from hframe_post.identification.recordings.resonance_test import (
    DEFAULTS,
    FORMER_MAX_FREQ,
    ResonanceTest,
)

USUAL_RATES = (1.0, 0.5, 2.0, 0.25, 0.2, 0.1, 1.5, 0.75, 3.0, 4.0, 5.0)  # Hz/s
LOW_HZ = 20.0  # to which motions are compared, unless the printer resonates earlier
RISE = 1.4  # of the level, where that is
SMOOTHING = 9.0  # ms, of motions before they are compared
REACH = 80  # ms by which the start may be off the line's
ELSEWHERE = (
    "the sensor did not move with this axis (it sat on the frame, on another head, or on the head "
    "while the bed moves, or the other way round)"
)


@dataclass(frozen=True, slots=True)
class Found:
    """What a recording shows of a resonance test.

    test: the motion that was played. clock: its start within 5 ms, the printer's delay included,
    its drift within 0.05 %. axis (3,): unit vector of the sensor's slow motion.
    """

    test: ResonanceTest
    clock: Clock
    axis: Array


@dataclass(frozen=True, slots=True)
class _Seen:
    """What a recording shows along the line of a test, on the command's clock.

    a (n, 3): every 1 ms. origin: s from the first sample to 0 Hz. last: Hz up to which the line is
    seen. hz, level (k,): frequencies, and the response to the pulses there, mm/s² per Hz. base:
    that at 0 Hz. low_hz: up to which the printer follows its motors.
    """

    a: Array
    rate: float
    origin: float
    last: float
    hz: Array
    level: Array
    base: float
    low_hz: float


@dataclass(frozen=True, slots=True)
class _Match:
    """A test compared with a recording.

    start: s on the command's clock. like: share explained. sweeping: size of the response to a
    sweeping of 1.
    """

    test: ResonanceTest
    start: float
    like: float
    sweeping: float


def find(recording: Recording, expected: ResonanceTest) -> Found:
    """Return the resonance test in a recording, which printer.cfg describes as ``expected``.

    Raises IdentificationError if there is none, if a part is missing, or if the recording does not
    show its motion.
    """
    line = find_line(uniform(recording.t, recording.a))
    if line is None:
        line = _as_expected(expected)
    rate, drift = _rate(line.slope, expected.hz_per_sec)
    a = uniform(recording.t / (1.0 + drift), recording.a)
    ends = rate * (len(a) * TS - line.origin / (1.0 + drift))
    if ends < line.first + 5.0:
        raise _cut(ends, expected.max_freq)
    seen = _seen(a, line, rate, drift)
    low, axis = _low_part(seen)
    known = replace(expected, hz_per_sec=rate, max_freq=seen.low_hz + 2.0)
    fit = _best_match(low, known, seen)
    for refusal in _refusals(seen, fit, expected, drift):
        raise refusal
    test = replace(_with_levels(fit, seen.base, expected), max_freq=_last_hz(seen, expected))
    clock = Clock(float(recording.t[0]) + fit.start * (1.0 + drift), drift)
    return Found(test, clock, axis)


def _as_expected(test: ResonanceTest) -> ChirpLine:
    """Return the line of a test that begins with the first sample."""
    rate, first = test.hz_per_sec, test.min_freq
    return ChirpLine(rate, -first / rate, np.zeros((0, 2)), first, test.max_freq)


def _rate(slope: float, expected: float) -> tuple[float, float]:
    """Return hz_per_sec and the drift of the clock on which a line has a slope in Hz/s."""
    drifts = {rate: float(np.sqrt(rate / slope)) - 1.0 for rate in (expected, *USUAL_RATES)}
    fitting = (rate for rate, drift in drifts.items() if abs(drift) < verdict.CLOCK_DRIFT)
    rate = next(fitting, expected)
    return rate, drifts[rate]


def _seen(a: Array, line: ChirpLine, rate: float, drift: float) -> _Seen:
    origin = line.origin / (1.0 + drift)
    since = np.arange(len(a)) * TS - origin
    turned = a * np.exp(-1j * np.pi * rate * np.square(since))[:, None]
    window = hann(1001)[:, None]
    turned = np.pad(turned, ((500, 500), (0, 0)), mode="reflect")
    slow: Complex = oaconvolve(turned, window / window.sum(), "valid", axes=0)
    hz = np.asarray(rate * since, dtype=np.float64)
    kept = slice(int(np.searchsorted(hz, line.first * (1.0 + drift) + 0.5)), None, 50)
    # a square wave's fundamental is 4/π times as large, half of it at positive frequencies
    level: Array = np.linalg.norm(slow[kept], axis=1) / hz[kept] * np.pi / 2.0
    hz = hz[kept]
    base = float(np.median(level[hz < hz[0] + 5.0]))
    risen = np.flatnonzero(level > RISE * base)
    edge = max(float(hz[risen[0]]) if risen.size else LOW_HZ, hz[0] + 4.0)
    low = hz <= edge
    # below a mode at f₀ the level is that at 0 Hz / (1 − (f/f₀)²); other modes are outliers
    columns = np.column_stack([np.ones(int(low.sum())), -np.square(hz[low])])
    fit = robust_fit(columns, 1.0 / level[low])
    base = 1.0 / float(fit[0]) if fit.min() > 0.0 else base
    last = min(line.last * (1.0 + drift), float(hz[-1]))
    return _Seen(a, rate, origin, last, hz, level, base, min(edge, max(LOW_HZ, hz[0] + 8.0)))


# ---------------------------------------------------------------------- the slow motion


def _low_part(seen: _Seen) -> tuple[Array, Array]:
    """Return the slow part (n,) of a recording along its strongest direction, and that (3,).

    The motion has one direction, noise has three.
    """
    slow = _smooth(seen.a[: int((seen.low_hz / seen.rate + seen.origin) / TS)])
    slow = slow - slow.mean(axis=0)
    axis = np.linalg.eigh(slow.T @ slow)[1][:, -1]
    return slow @ axis, np.asarray(axis)


def _smooth(a: Array) -> Array:
    return np.asarray(gaussian_filter1d(a, SMOOTHING, axis=0))


def _best_match(low: Array, known: ResonanceTest, seen: _Seen) -> _Match:
    """Return the best comparison among all first frequencies and kinds of pulses."""
    rate, origin = seen.rate, seen.origin
    earliest = max(-rate * (origin + 0.5), 1.0)
    latest = max(float(seen.hz[0]) + 0.5, earliest + 1.0)
    usual = {known.min_freq, *np.arange(1.0, 300.0, 0.5).tolist()}
    unit = replace(known, accel_per_hz=1.0, sweeping_accel=1.0)
    kinds = [
        replace(unit, sweeping_period=_sweeping_period(seen, known.sweeping_period)),
        replace(unit, sweeping_period=0.0, around_point=True),
    ]
    hz = np.maximum((np.arange(len(low)) * TS - origin) * rate, latest - 1.0)
    fits = [
        _compared(low, 1.0 / hz, replace(kind, min_freq=f), f / rate + origin)
        for f in usual
        if earliest <= f <= latest
        for kind in kinds
    ]
    best = max(fits, key=lambda fit: fit.like)
    if best.sweeping > verdict.SHOWN * known.sweeping_accel:
        return best
    return replace(best, test=replace(best.test, sweeping_period=0.0), sweeping=0.0)


def _sweeping_period(seen: _Seen, expected: float) -> float:
    """Return the period, s, of what is strongest in a recording below the pulses."""
    slow = seen.a[: len(seen.a) // 50 * 50].reshape(-1, 50, 3).mean(axis=1)  # one every 50 ms
    padded = 8 * len(slow)
    size = np.linalg.norm(rfft(slow * hann(len(slow))[:, None], padded, axis=0), axis=1)
    hz = rfftfreq(padded, 50.0 * TS)
    inside = (hz > 0.25) & (hz < 3.3)
    period = 1.0 / float(hz[inside][np.argmax(size[inside])])
    usual = (p for p in (expected, DEFAULTS["sweeping_period"]) if abs(period - p) < 0.02 * period)
    return next(usual, round(period, 2))


def _compared(low: Array, weight: Array, test: ResonanceTest, start: float) -> _Match:
    """Return the comparison at the best start near the one given, in s."""
    first = round(start / TS)
    parts = [test.pulses(), test.sweeping()] if test.sweeping_period else [test.pulses()]
    rows = np.arange(len(low)) - first
    columns = [np.ones(len(low))]
    for part in parts:
        slow = _smooth(np.diff(np.pad(part, 100, mode="edge"), 2) / TS**2)
        columns.append(np.interp(rows, np.arange(len(slow)) - 99, slow, 0.0, 0.0))
    u = (np.column_stack(columns) * weight[:, None])[REACH:-REACH]
    like, sizes = follows(u, (low * weight)[:, None])
    k = int(np.argmax(like))
    sweeping = abs(float(sizes[k, 2, 0])) if test.sweeping_period else 0.0
    return _Match(test, (first + summit(like) - REACH) * TS, float(like[k]), sweeping)


def _rests_before(a: Array, start: float) -> bool:
    """Return whether the printer of a recording rests before a motion that starts at s."""
    first = int(start / TS) - 50
    moving = float(a[max(first, 0) :][:1000].std(axis=0).max())
    return first > 0 and float(a[:first].std(axis=0).max()) < 0.5 * moving


# ---------------------------------------------------------------------- the end, and levels


def _last_hz(seen: _Seen, expected: ResonanceTest) -> float:
    """Return the frequency at which the pulses end."""
    hz, around = seen.hz, seen.hz - seen.last
    usually = np.median(seen.level[(around > -3.0) & (around < -1.0)])
    last = float(hz[(seen.level > 0.5 * usually) & (np.abs(around) < 2.0)][-1])
    end = float(hz[-1])
    ended = end - last > 0.2 * seen.rate
    usual = [expected.max_freq, DEFAULTS["max_freq"], FORMER_MAX_FREQ]
    found = min([*usual, 5.0 * round(last / 5.0)] if ended else usual, key=lambda f: abs(f - last))
    if abs(found - last) < 0.4 * max(1.0, seen.rate):
        return found
    # the firmware stops recording within a second after the motion, whose end noise may hide
    usual = [*usual, 5.0 * (end // 5.0)] if ended else usual[:1]
    hidden = (f for f in usual if f <= end < f + seen.rate)
    return next(hidden, round(last, 1) if ended else expected.max_freq)


def _with_levels(fit: _Match, level: float, expected: ResonanceTest) -> ResonanceTest:
    """Return the test with levels from the recording where they are not those expected."""
    sweeping_accel, gain = expected.sweeping_accel, 1.0
    if fit.test.sweeping_period:
        sweeping_accel = _usual(fit.sweeping, (sweeping_accel, 400.0, 200.0), 10.0)
        gain = fit.sweeping / sweeping_accel
    accel_per_hz = _usual(level / gain, (expected.accel_per_hz, 60.0, 75.0), 1.0)
    return replace(fit.test, accel_per_hz=accel_per_hz, sweeping_accel=sweeping_accel)


def _usual(found: float, usual: tuple[float, ...], step: float) -> float:
    """Return the expected, first value if it is near enough, another if nearer, or a round one."""
    # sensors and printers may differ by a fifth from the level expected
    for value, tolerance in zip(usual, (0.2, 0.1, 0.1), strict=True):
        if abs(found / value - 1.0) < tolerance:
            return value
    return max(step, step * round(found / step))


# ---------------------------------------------------------------------- verdict


def _refusals(
    seen: _Seen, fit: _Match, expected: ResonanceTest, drift: float
) -> Iterator[IdentificationError]:
    """Yield why a recording does not show the motion of a test, the likeliest cause first."""
    hz, level, base = seen.hz, seen.level, seen.base
    whole = fit.test.min_freq == expected.min_freq or _rests_before(seen.a, fit.start)
    begins, ends, share = -seen.rate * seen.origin, float(hz[-1]), base / expected.accel_per_hz
    # a test of weak pulses still has its sweeping in full
    if max(share, 0.5 * fit.sweeping / expected.sweeping_accel) < verdict.SHOWN:
        cause = ELSEWHERE
        if not fit.test.sweeping_period and base > 1.0:
            cause = (
                f"either {ELSEWHERE}, or the test was run with ACCEL_PER_HZ={base:.2g}: set "
                f"accel_per_hz in [resonance_tester], which is {expected.accel_per_hz:g}"
            )
        yield IdentificationError(
            f"the recording shows {100.0 * share:.0f} % of the acceleration that the test makes, "
            f"not {100.0 * verdict.SHOWN:.0f} % or more: {cause}"
        )
    if whole or begins < expected.min_freq + verdict.UNRECORDED_S * seen.rate:
        if fit.like < verdict.EXPLAINED:
            yield IdentificationError(
                f"the recording shows no resonance test: {100.0 * max(fit.like, 0.0):.0f} % of "
                f"what it shows below {seen.low_hz:.0f} Hz is that motion, not "
                f"{100.0 * verdict.EXPLAINED:.0f} % or more. Either {ELSEWHERE}, or input "
                "shaping was on (INPUT_SHAPING=1), or another program made it. If it is of a "
                "sweep, put the CSV file that 'hframe-post measure' wrote next to it"
            )
        slow = hz <= seen.low_hz
        growth = float(np.polyfit(np.log(hz[slow]), np.log(level[slow]), 1)[0])
        if growth < verdict.TEST_GROWTH:
            yield IdentificationError(
                "the recording's frequency grows, but its acceleration does not grow with it (to "
                f"its power of {1.0 + growth:.2f}; a test to {1.0 + verdict.TEST_GROWTH:g} or "
                "more): this is another program's sweep"
            )
    if abs(drift) > verdict.CLOCK_DRIFT:
        yield IdentificationError(
            f"the recording's frequency grows by {seen.rate / (1.0 + drift) ** 2:.3g} Hz/s, not by "
            f"hz_per_sec {seen.rate:g}, and no sensor's clock is {100.0 * abs(drift):.0f} % wrong "
            f"(at most {100.0 * verdict.CLOCK_DRIFT:g} %). Set hz_per_sec in [resonance_tester] as "
            "it was in the test; if it was, the file's time is not in seconds"
        )
    if (last := _last_hz(seen, expected)) > ends + verdict.UNRECORDED_S * seen.rate:
        yield _cut(ends, last)
    if not whole:
        yield IdentificationError(
            f"the recording begins in the middle of the resonance test, at {begins:.0f} Hz: it was "
            f"cut (use the whole file), or min_freq was not {expected.min_freq:g} as in "
            "[resonance_tester]: set it as it was in the test"
        )
    inside = level[hz < seen.last]
    if inside.max() < verdict.TEST_PEAK * base and inside.min() < 0.5 * base:
        fades = float(hz[np.argmax(inside < 0.5 * base)])
        yield IdentificationError(
            f"the recording shows no resonance (at most {inside.max() / base:.1f} times its level "
            f"at low frequencies, not {verdict.TEST_PEAK:g}), and from {fades:.0f} Hz on less than "
            "half of the test's motion. Either input shaping was on (repeat TEST_RESONANCES "
            "without INPUT_SHAPING=1), or something soft lies between motors and sensor, such as "
            "a slack belt or a sensor that is not screwed on"
        )


def _cut(ends: float, last: float) -> IdentificationError:
    return IdentificationError(
        f"the recording ends in the middle of the resonance test, at {ends:.0f} Hz of "
        f"{last:g} Hz: it was cut. Use the whole file"
    )
