"""A resonance test found in its recording: its true parameters, its start and the clock's drift.

The pulses draw a line into the spectrogram (``chirp_line``). On a sensor's clock that is fast by
d its slope is hz_per_sec / (1 + d)². Then the motion itself is compared with the recording at low
frequencies, where a printer still follows its motors: this gives the first frequency, the kind
of pulses, the start, and the levels of pulses and sweeping.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.fft import next_fast_len, rfft, rfftfreq
from scipy.ndimage import uniform_filter1d
from scipy.signal import fftconvolve
from scipy.signal.windows import hann

from hframe_post.arrays import Array
from hframe_post.errors import IdentificationError
from hframe_post.identification.recordings.accelerometer import PLAUSIBLE, Recording
from hframe_post.identification.recordings.chirp_line import ChirpLine, find_line
from hframe_post.identification.recordings.resonance_checks import (
    check_level,
    check_motion,
    check_shaping,
    rests_before,
)
from hframe_post.identification.recordings.resonance_match import (
    RATE,
    Match,
    best_match,
    cut_at_start,
    low_part,
)
from hframe_post.identification.recordings.resonance_test import (
    DEFAULTS,
    FORMER_MAX_FREQ,
    ResonanceTest,
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
            "a sweep, put the CSV file that 'hframe-post sweep' wrote next to it"
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
