"""Proof on the machine: what an accelerometer heard of a test motion, plain and compensated.

A sensor knows accelerations only, so the nozzle's place is the model's prediction p
and what the recording says it is off,

    place = p + ∬ (a_measured − a_predicted),

without what lies below LOW_HZ, where integrated noise would hide all. From it follow the contour
error of both runs, and from both the reduction, which no longer rests on the model being right.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft, rfftfreq

from hframe_post.arrays import TS, Array, Flags, X, Y, Z
from hframe_post.errors import IdentificationError
from hframe_post.identification.recordings.accelerometer import Recording
from hframe_post.identification.recordings.alignment import acceleration, aligned
from hframe_post.identification.verification.motion import QUIET, after_corners, motion_of
from hframe_post.identification.verification.verdict import Verdict
from hframe_post.model.plant import Response
from hframe_post.prediction.contour import contour_error
from hframe_post.printer.settings import Printer

LOW_HZ, FLAT_HZ, HIGH_HZ = 3.0, 6.0, 120.0  # what is integrated, wholly from FLAT_HZ on
GAIN_HZ = (2.0, 9.0)  # in which sensor and prediction must agree on the motion as a whole
MOST_OFF = 0.1  # of a sensor's gains and cross terms
RACKING_HZ = (9.0, 100.0)  # in which racking is told from a sensor that is turned


def judge(printer: Printer, plain: tuple[Array, Recording],
          compensated: tuple[Array, Recording]) -> Verdict:  # fmt: skip
    """The verdict of both runs: command (m, 2) mm every 1 ms, and what the nozzle's sensor heard.

    Raises IdentificationError where a recording is not that of its command.
    """
    wanted = plain[0]
    if len(wanted) != len(compensated[0]):
        raise IdentificationError("the two commands are not of one verification")
    part = motion_of(wanted)
    heard = [_heard(printer, *run) for run in (plain, compensated)]
    moving = np.zeros(len(wanted), dtype=bool)
    moving[part] = (np.diff(wanted[part], axis=0, append=wanted[-1:]) != 0.0).any(axis=1)
    at = np.arange(len(wanted))
    of_path = np.column_stack([acceleration(wanted[:, k]) for k in (X, Y)])
    after = after_corners(wanted) & _inside(part, len(wanted))
    measured, predicted, ringing = [], [], []
    errors = [
        [1e3 * contour_error(wanted, place, at)[moving] for place in (one.place, one.predicted)]
        for one in heard
    ]
    for one, (real, model) in zip(heard, errors, strict=True):
        measured.append(float(np.sqrt(max((real**2).mean() - (1e3 * one.noise) ** 2, 0.0))))
        predicted.append(float(np.sqrt((model**2).mean())))
        ringing.append(float(np.sqrt(((one.a - of_path)[after] ** 2).sum(axis=1).mean())))
    missed, beside = ((heard[0].a - other)[part] for other in (heard[0].a_predicted, of_path))
    low, high = GAIN_HZ[1], HIGH_HZ
    unexplained = _rms(missed, low, high) / max(_rms(beside, low, high), 1e-9)
    return Verdict(
        (measured[0], measured[1]), (predicted[0], predicted[1]), (ringing[0], ringing[1]),
        unexplained, _racking(heard, part), np.asarray(TS * np.flatnonzero(moving)),
        (errors[0][0], errors[1][0]), (errors[0][1], errors[1][1]),
    )  # fmt: skip


@dataclass(frozen=True, slots=True)
class _Heard:
    """A run: places (m, 2) by measurement and by the model, accelerations, noise of a place, mm.

    a_racking (m,): of a_predicted in y, what racking is of it.
    """

    place: Array
    predicted: Array
    a: Array
    a_predicted: Array
    a_racking: Array
    noise: float


def _heard(printer: Printer, command: Array, recording: Recording) -> _Heard:
    u = acceleration(command[:, X])
    found = aligned(u, recording, X)
    predicted = Response(printer.plant, command[0]).run(command)
    without = Response(replace(printer.plant, Gxtheta=None), command[0]).run(command)
    a_predicted = np.column_stack([acceleration(predicted[:, k]) for k in (X, Y)])
    a = found.acceleration[:, :Z] @ _correction(found.acceleration[:, :Z], a_predicted)
    late = _lag(a, a_predicted)
    a = _shifted(a, -float(np.clip(late, -found.uncertainty, found.uncertainty)))
    off = _integrated(a - a_predicted)
    quiet = np.concatenate([off[200 : QUIET - 200], off[-QUIET + 500 : -200]])
    noise = float(np.sqrt((quiet**2).mean()))
    a_racking = acceleration(predicted[:, Y] - without[:, Y])
    return _Heard(predicted + off, predicted, a, a_predicted, a_racking, noise)


def _racking(heard: Sequence[_Heard], part: slice) -> tuple[float, float] | None:
    """How many times as far as predicted the nozzle racks, and the standard deviation of that.

    Of least squares over both runs; what the model misses in y for other reasons is as noise.
    """
    rows = [(one.a_racking, (one.a - one.a_predicted)[:, Y]) for one in heard]
    own, missed = (
        np.concatenate([_within(values[part, None], *RACKING_HZ)[:, 0] for values in column])
        for column in zip(*rows, strict=True)
    )
    power = float(own @ own)
    if power == 0.0:
        return None
    times = float(own @ missed) / power
    left = missed - times * own
    independent = 2.0 * (RACKING_HZ[1] - RACKING_HZ[0]) * TS  # of a sample
    return 1.0 + times, float(np.sqrt((left @ left) / power / (independent * len(own))))


def _correction(a: Array, wanted: Array) -> Array:
    """The matrix (2, 2) that takes out the sensor's gains and how it is turned.

    From slow motion, in which any printer follows: any model predicts it alike.
    """
    slow, true = (_within(values, *GAIN_HZ) for values in (a, wanted))
    matrix = np.linalg.lstsq(slow, true, rcond=None)[0]
    off = np.abs(matrix - np.eye(2)).max()
    if off > MOST_OFF + np.sin(np.radians(10.0)):
        raise IdentificationError(
            f"the recording differs from the command by {100 * off:.0f} % in slow motion: the "
            "axis map is wrong, or it is another run's"
        )
    return np.asarray(matrix)


def _lag(a: Array, wanted: Array) -> float:
    """Seconds by which a is late, of least squares over the phase."""
    n = next_fast_len(len(a))
    hz = rfftfreq(n, TS)
    inside = (hz > GAIN_HZ[0]) & (hz < 40.0)
    omega = 2.0 * np.pi * hz[inside]
    cross = (rfft(a, n, axis=0) * rfft(wanted, n, axis=0).conj()).sum(axis=1)[inside]
    weight = np.abs(cross)
    return float(-(weight * omega * np.angle(cross)).sum() / (weight * omega**2).sum())


def _shifted(a: Array, seconds: float) -> Array:
    n = next_fast_len(len(a) + 64)
    turn = np.exp(-2j * np.pi * rfftfreq(n, TS) * seconds)
    return np.asarray(irfft(rfft(a, n, axis=0) * turn[:, None], n, axis=0)[: len(a)])


def _integrated(a: Array) -> Array:
    """Twice, over time, without what is slow: mm of mm/s², (m, 2)."""
    n = next_fast_len(2 * len(a))
    hz = rfftfreq(n, TS)
    u = np.clip((hz - LOW_HZ) / (FLAT_HZ - LOW_HZ), 0.0, 1.0)
    kept = u * u * (3.0 - 2.0 * u) * (hz < HIGH_HZ)
    spectrum = rfft(a, n, axis=0) * (-kept / np.maximum(2.0 * np.pi * hz, 1.0) ** 2)[:, None]
    return np.asarray(irfft(spectrum, n, axis=0)[: len(a)])


def _within(a: Array, low: float, high: float) -> Array:
    n = next_fast_len(len(a))
    hz = rfftfreq(n, TS)
    spectrum = rfft(a, n, axis=0)
    spectrum[(hz < low) | (hz > high)] = 0.0
    return np.asarray(irfft(spectrum, n, axis=0)[: len(a)])


def _rms(a: Array, low: float, high: float) -> float:
    return float(np.sqrt((_within(a, low, high) ** 2).sum(axis=1).mean()))


def _inside(part: slice, n: int) -> Flags:
    flags = np.zeros(n, dtype=bool)
    flags[part] = True
    return flags
