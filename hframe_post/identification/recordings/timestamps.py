"""Time stamps of a recording: gaps are filled, and stamps that wander give way to the samples.

A sensor takes its samples evenly, by an oscillator of its own, and a program estimates when. These
estimates may wander: those of Klipper by 10 ms around the true times of a LIS2DW at 400 Hz, and by
40 ms in the first seconds. At 40 Hz that is a whole turn. Numbers of samples do not wander.

An oscillator changes its rate slowly, by 43 ms in (100 s)² at the most that was seen. So its stamps
lie on a parabola over a second; stamps that a program guessed do not.
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import make_smoothing_spline
from scipy.signal import savgol_filter

from hframe_post.arrays import Array, Integers

GAP = 2.5  # sample periods between neighbours, from which samples are missing
BLOCK = 0.1  # s of samples whose stamps are averaged
STEADY = 15.0  # s over which an oscillator keeps its rate; temperature changes it later
NEAR = 11  # blocks through which a parabola is laid
# s by which blocks may be off it, by their median: 2 to 5 µs on 15 recordings of an ADXL345, 18 µs
# on those of 2 s; 65 to 122 µs on four of a LIS2DW
WANDER_S = 3e-5
EVEN = 0.25  # sample periods by which the stamps of one block may deviate from a line
ROUNDS = 8


def repaired(t: Array, a: Array) -> tuple[Array, Array, tuple[str, ...]]:
    """Return times (n,) in s and accelerations (n, 3) of even samples, and notes of the changes.

    t (m,): rising. Short gaps are filled with straight lines. Stamps that wander are replaced by
    those of an oscillator with a slowly changing rate, unless the samples themselves are uneven.
    """
    period = float(np.median(np.diff(t)))
    number = _numbers(t, period)
    t, notes = _by_oscillator(t, number)
    missing = len(t) and int(number[-1]) + 1 - len(t)
    if not missing:
        return t, a, notes
    step = np.diff(t)
    longest = int(np.argmax(step))
    whole = np.arange(number[-1] + 1)
    filled = np.interp(whole, number, t)
    a = np.column_stack([np.interp(whole, number, values) for values in a.T])
    note = (
        f"{missing} samples ({100.0 * missing / len(whole):.2g} %) are missing; the longest "
        f"gap is {1e3 * step[longest]:.3g} ms at {t[longest]:.6g} s"
    )
    return filled, a, (note, *notes)


def _numbers(t: Array, period: float) -> Integers:
    """Return the numbers (n,) of the samples, those that are missing counted."""
    step = np.diff(t)
    wide = step > GAP * period
    even = float(step[~wide].mean())  # a median of rounded stamps is rounded, too
    count = np.where(wide, np.rint(step / even), 1.0).astype(np.int64)
    return np.concatenate([[0], np.cumsum(count)])


def _by_oscillator(t: Array, number: Integers) -> tuple[Array, tuple[str, ...]]:
    """Return the stamps (n,), or those of an oscillator if they wander around even samples."""
    period, first = np.polyfit(number, t - t[0], 1)
    late = t - t[0] - (first + period * number)
    size = max(round(BLOCK / period), 2)
    count = len(t) // size
    if count < NEAR:
        return t, ()
    numbers, offsets = (v[: count * size].reshape(count, size) for v in (number, late))
    centred = numbers - numbers.mean(axis=1, keepdims=True)
    slope = (centred * offsets).sum(axis=1) / np.square(centred).sum(axis=1)
    offset = offsets.mean(axis=1)
    uneven = offsets - offset[:, None] - slope[:, None] * centred
    if float(np.median(uneven.std(axis=1))) > EVEN * period:
        return t, ()
    if float(np.median(np.abs(offset - savgol_filter(offset, NEAR, 2)))) < WANDER_S:
        return t, ()
    at, weight = numbers.mean(axis=1) * period, np.ones(count)
    stiffness = STEADY**4 / BLOCK
    for _ in range(ROUNDS):
        steady = make_smoothing_spline(at, offset, weight, stiffness)
        miss = np.abs(offset - steady(at))
        weight = 1.0 / (1.0 + np.square(miss / (2.0 * float(np.median(miss)) + 1e-9)))
    note = (
        f"its time stamps wander by up to {1e3 * float(miss.max()):.2g} ms; the evenness of its "
        "samples is used instead"
    )
    return np.asarray(t[0] + first + period * number + steady(number * period)), (note,)
