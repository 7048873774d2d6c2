"""Proof on the machine: a test motion, plain and compensated, and what an accelerometer heard.

The motion is a rectangle and a zigzag at the profile's limits, each played several times between
two marks. A sensor knows accelerations only, so the nozzle's place is the model's prediction p
and what the recording says it is off,

    place = p + ∬ (a_measured − a_predicted),

without what lies below LOW_HZ, where integrated noise would hide all. From it follow the contour
error of both runs, and from both the reduction, which no longer rests on the model being right.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft, rfftfreq

from hframe_post.arrays import TS, Array, Flags, X, Y, Z
from hframe_post.conversion.pipeline import Commands, Options
from hframe_post.errors import IdentificationError
from hframe_post.identification.accelerometer import Recording
from hframe_post.identification.alignment import acceleration, aligned
from hframe_post.identification.excitation import alignment_mark
from hframe_post.identification.sweep import Run, room
from hframe_post.model.plant import Response
from hframe_post.prediction.contour import contour_error
from hframe_post.printer.settings import Printer
from hframe_post.stream.types import frozen

NAMES = ("none", "racking")  # the strategies that are compared
LENGTHS, LOOPS = (40.0, 20.0), 4  # mm; how often the motion is played
LEG, LEGS = 12.0, 6  # of the zigzag: mm along x, and how many
QUIET = 1000  # samples of rest before, between and after the parts
LOW_HZ, FLAT_HZ, HIGH_HZ = 3.0, 6.0, 120.0  # what is integrated, wholly from FLAT_HZ on
GAIN_HZ = (2.0, 9.0)  # in which sensor and prediction must agree on the motion as a whole
MOST_OFF = 0.1  # of a sensor's gains and cross terms
RINGING = 150  # samples after a corner
TURN = 0.3  # radians that make one
HELPS = 0.2  # reduction below which a profile is not worth its risk
AS_PREDICTED = 0.6  # of the predicted reduction, at least
UNEXPLAINED = 0.4  # of what the nozzle does beside its path, that the model may miss


def path(printer: Printer) -> list[bytes]:
    """The test motion as G-code, in the middle of the travel, at the printer's own limits."""
    (x0, x1), (y0, y1) = printer.travel.x, printer.travel.y
    width, height = (min(length, (high - low) / 3.0) for length, (low, high) in zip(
        LENGTHS, ((x0, x1), (y0, y1)), strict=True))  # fmt: skip
    # to one side of the middle, so that the lever arm of racking is long
    left, low = (x0 + x1) / 2.0 + (x1 - x0) / 6.0 - width / 2.0, (y0 + y1) / 2.0 - height / 2.0
    speed = f"F{60.0 * printer.limits.velocity:g}"
    lines = ["G28", "G90", "M83", f"G1 X{left:.3f} Y{low:.3f} {speed}", "G4 P500"]
    for _ in range(LOOPS):
        corners = [(width, 0.0), (width, height), (0.0, height), (0.0, 0.0)]
        leg = min(LEG, width / LEGS)
        corners += [(leg * (k + 1), leg * ((k + 1) % 2)) for k in range(LEGS)]
        corners += [(0.0, 0.0)]
        lines += [f"G1 X{left + x:.3f} Y{low + y:.3f}" for x, y in corners]
    return [f"{line}\n".encode() for line in lines]


def runs(printer: Printer) -> list[Run]:
    """Both runs, to be played and recorded one after the other. Raises HframeError."""
    options = Options("racking", limits="printer")
    source = Commands(path(printer), printer, options, NAMES)
    held = [chunk for chunk in source.computed() if len(chunk)]
    wanted = np.concatenate([chunk.xyze[:, :Z] for chunk in held])
    begin = _begin(wanted)
    made = []
    for name, strategy in (("verify-plain", "none"), ("verify-compensated", "racking")):
        motion = np.concatenate([chunk.commands[strategy] for chunk in held])[begin:]
        made.append(Run(name, X, (float(motion[0, X]), float(motion[0, Y])),
                        frozen(_framed(motion, printer))))  # fmt: skip
    return made


def _begin(wanted: Array) -> int:
    """Where the test motion begins: after the last long rest of the approach."""
    still = np.flatnonzero((np.diff(wanted, axis=0) == 0.0).all(axis=1))
    ends = still[np.flatnonzero(np.diff(still, append=len(wanted) + 2) > 1)]
    first = np.flatnonzero((wanted == wanted[ends[0]]).all(axis=1)) if len(ends) else [0]
    candidates = [end for end in ends.tolist() if end < len(wanted) // 2]
    return int(candidates[-1]) if candidates else int(first[0])


def _framed(motion: Array, printer: Printer) -> Array:
    """The motion between two marks, with rests."""
    limits = printer.limits
    left = min(room(printer, X, (float(p[X]), float(p[Y]))) for p in motion[[0, -1]])
    mark = alignment_mark(printer.sweep, limits.velocity, left)
    parts = []
    for at in motion[[0, -1]]:
        marked = np.tile(at, (len(mark), 1))
        marked[:, X] += mark
        parts.append(marked)
    first, last = (np.tile(at, (QUIET, 1)) for at in motion[[0, -1]])
    return np.concatenate([first, parts[0], first, motion, last, parts[1], last])


@dataclass(frozen=True, slots=True)
class Verdict:
    """What both recordings tell, µm RMS of contour error and mm/s² RMS of ringing after corners.

    Each pair: plain, compensated. unexplained: of what the nozzle does beside its path, the share
    that the model did not predict. at (n,): s, of the errors (n,) in µm along the motion.
    """

    measured: tuple[float, float]
    predicted: tuple[float, float]
    ringing: tuple[float, float]
    unexplained: float
    at: Array
    errors_measured: tuple[Array, Array]
    errors_predicted: tuple[Array, Array]

    @property
    def reduction(self) -> float:
        """Of the measured contour error, by compensation; negative where it is worse."""
        plain, compensated = self.measured
        return 1.0 - compensated / plain

    @property
    def expected(self) -> float:
        """The same as the model predicts it."""
        plain, compensated = self.predicted
        return 1.0 - compensated / plain

    @property
    def fault(self) -> str | None:
        """Why the profile does not stand; None if it does."""
        if self.reduction <= 0.0:
            return (
                "compensation makes this printer WORSE: the profile is not that of this printer, "
                "or the printer has changed. Do not print with it; sweep and identify again"
            )
        if self.unexplained > UNEXPLAINED:
            return (
                f"the model misses {100 * self.unexplained:.0f} % of what the nozzle does: the "
                "profile is not that of this printer as it is now. Sweep and identify again"
            )
        if self.reduction < max(HELPS, AS_PREDICTED * self.expected):
            return (
                f"compensation takes {100 * self.reduction:.0f} % off the error, not the "
                f"{100 * self.expected:.0f} % that the model promises: sweep and identify again"
            )
        return None

    def as_text(self) -> str:
        """For a person."""
        rows = [
            ("contour error measured", self.measured, "µm"),
            ("contour error predicted", self.predicted, "µm"),
            ("ringing after corners", self.ringing, "mm/s²"),
        ]
        lines = [f"{'RMS':26s}{'plain':>10s}{'compensated':>14s}"]
        lines += [f"{name:26s}{a:10.1f}{b:14.1f}  {unit}" for name, (a, b), unit in rows]
        lines.append(f"{'the model misses':26s}{100 * self.unexplained:10.0f} %")
        word = self.fault or f"compensation takes {100 * self.reduction:.0f} % off the error"
        return "\n".join([*lines, f"VERDICT     {'FAILED: ' if self.fault else 'good: '}{word}"])

    def as_json(self) -> dict[str, object]:
        """Ready for ``json.dumps``."""
        pairs = {"measured_um": self.measured, "predicted_um": self.predicted,
                 "ringing": self.ringing}  # fmt: skip
        told = {
            name: {"plain": round(a, 3), "compensated": round(b, 3)}
            for name, (a, b) in pairs.items()
        }
        return {
            **told, "reduction": round(self.reduction, 4), "expected": round(self.expected, 4),
            "unexplained": round(self.unexplained, 4), "fault": self.fault,
        }  # fmt: skip


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
    after = _after_corners(wanted) & _inside(part, len(wanted))
    measured, predicted, ringing = [], [], []
    errors = [
        [1e3 * contour_error(wanted, place, at)[moving] for place in (one.place, one.predicted)]
        for one in heard
    ]
    for one, (real, model) in zip(heard, errors, strict=True):
        measured.append(float(np.sqrt(max((real**2).mean() - (1e3 * one.noise) ** 2, 0.0))))
        predicted.append(float(np.sqrt((model**2).mean())))
        ringing.append(float(np.sqrt(((one.a - of_path)[after] ** 2).sum(axis=1).mean())))
    missed = np.concatenate([(one.a - one.a_predicted)[part] for one in heard[:1]])
    beside = (heard[0].a - of_path)[part]
    low, high = GAIN_HZ[1], HIGH_HZ
    unexplained = _rms(missed, low, high) / max(_rms(beside, low, high), 1e-9)
    return Verdict(
        (measured[0], measured[1]), (predicted[0], predicted[1]), (ringing[0], ringing[1]),
        unexplained, np.asarray(TS * np.flatnonzero(moving)), (errors[0][0], errors[1][0]),
        (errors[0][1], errors[1][1]),
    )  # fmt: skip


@dataclass(frozen=True, slots=True)
class _Heard:
    """A run: places (m, 2) by measurement and by the model, accelerations, noise of a place, mm."""

    place: Array
    predicted: Array
    a: Array
    a_predicted: Array
    noise: float


def _heard(printer: Printer, command: Array, recording: Recording) -> _Heard:
    u = acceleration(command[:, X])
    found = aligned(u, recording, X)
    predicted = Response(printer.plant, command[0]).run(command)
    a_predicted = np.column_stack([acceleration(predicted[:, k]) for k in (X, Y)])
    a = found.acceleration[:, :Z] @ _correction(found.acceleration[:, :Z], a_predicted)
    late = _lag(a, a_predicted)
    a = _shifted(a, -float(np.clip(late, -found.uncertainty, found.uncertainty)))
    off = _integrated(a - a_predicted)
    quiet = np.concatenate([off[200 : QUIET - 200], off[-QUIET + 500 : -200]])
    return _Heard(predicted + off, predicted, a, a_predicted, float(np.sqrt((quiet**2).mean())))


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


def motion_of(wanted: Array) -> slice:
    """The test motion, without marks and rests."""
    moving = np.flatnonzero((np.diff(wanted, axis=0) != 0.0).any(axis=1))
    breaks = np.flatnonzero(np.diff(moving) > QUIET // 2)
    return slice(int(moving[breaks[0] + 1]), int(moving[breaks[-1]]) + 1)


def _inside(part: slice, n: int) -> Flags:
    flags = np.zeros(n, dtype=bool)
    flags[part] = True
    return flags


def _after_corners(wanted: Array) -> Flags:
    """Samples within RINGING of a corner of the path, (m,)."""
    step = np.diff(wanted, axis=0, append=wanted[-1:])
    moving = np.flatnonzero((step != 0.0).any(axis=1))
    heading = np.arctan2(step[moving, Y], step[moving, X])
    turn = np.abs(np.angle(np.exp(1j * np.diff(heading))))
    flags = np.zeros(len(wanted), dtype=bool)
    for k in moving[1:][turn > TURN].tolist():
        flags[k : k + RINGING] = True
    return flags
