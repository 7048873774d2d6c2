"""A resonance test's motion compared with a recording, at low frequencies."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.ndimage import gaussian_filter1d

from hframe_post.arrays import TS, Array
from hframe_post.errors import IdentificationError
from hframe_post.identification.recordings.chirp_line import ChirpLine
from hframe_post.identification.recordings.resonance_test import ResonanceTest

RATE = 500.0  # samples a second of a recording that is searched
SMOOTHING = 9.0  # ms, of motions before they are compared
STEP = 5  # ms between their samples
REACH = 16  # steps by which the start may be off the line's
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
    margin = n + REACH + LEAD
    least = margin - first + LEAD - REACH
    views = [
        sliding_window_view(np.pad(part, margin)[least : least + n + 2 * REACH], n)[::-1]
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
    late, top = float(k - REACH), float(like[k])
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
