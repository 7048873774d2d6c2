"""Whether compensation helps the real machine: a rectangle and a zigzag.

The motion is played plain and compensated. Where it begins, and its corners, are found again from
the command itself. A sensor measures accelerations only, so the place of
the nozzle is the model's prediction p, corrected by the recording,

    place = p + ∬ (a_measured − a_predicted),

without frequencies below LOW_HZ, where integrated noise would hide everything. The contour error
of both runs follows, and from it the reduction, which does not rely on the model being right.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft, rfftfreq

from hframe_post.arrays import TS, Array, Complex, Flags, X, Y, Z
from hframe_post.conversion.options import Options
from hframe_post.conversion.pipeline import SampleStream
from hframe_post.errors import HframeError, IdentificationError, LimitError
from hframe_post.identification import verdict
from hframe_post.identification.estimation.measured import Run
from hframe_post.identification.recordings.clock import acceleration
from hframe_post.identification.recordings.runs import PlannedRun, check_records
from hframe_post.model.nozzle import nozzle
from hframe_post.prediction.predict import contour_error
from hframe_post.printer.settings import Printer
from hframe_post.stream.types import frozen

STRATEGIES = {"verify-plain": "none", "verify-compensated": "racking"}  # by the names of runs
LENGTHS, LOOPS = (40.0, 20.0), 4  # sides of the rectangle in mm; how often it is traced
LEG, LEGS = 12.0, 6  # of the zigzag: mm along x, and number
GENTLER = (1.0, 0.7, 0.5, 0.35)  # shares of the path's acceleration and jerk, tried in turn
QUIET = 1000  # samples of rest before and after it


def path(printer: Printer) -> list[bytes]:
    """Return the test motion as G-code, in the middle of the travel, at the printer's limits."""
    (x0, x1), (y0, y1) = printer.travel.x, printer.travel.y
    width, height = (min(length, (high - low) / 3.0) for length, (low, high) in zip(
        LENGTHS, ((x0, x1), (y0, y1)), strict=True))  # fmt: skip
    # the model holds in the middle; away from it racking has a long lever arm
    off = (x1 - x0) / 6.0 if printer.plant.Gxtheta is not None else 0.0
    left, low = (x0 + x1) / 2.0 + off - width / 2.0, (y0 + y1) / 2.0 - height / 2.0
    speed = f"F{60.0 * printer.limits.velocity:g}"
    lines = ["G28", "G90", "M83", f"G1 X{left:.3f} Y{low:.3f} {speed}", "G4 P500"]
    for _ in range(LOOPS):
        corners = [(width, 0.0), (width, height), (0.0, height), (0.0, 0.0)]
        leg = min(LEG, width / LEGS)
        corners += [(leg * (k + 1), leg * ((k + 1) % 2)) for k in range(LEGS)]
        corners += [(0.0, 0.0)]
        lines += [f"G1 X{left + x:.3f} Y{low + y:.3f}" for x, y in corners]
    return [f"{line}\n".encode() for line in lines]


def runs(printer: Printer) -> list[PlannedRun]:
    """Return the plain and the compensated run.

    The motion is gentler where the motors cannot follow it at the printer's limits. Raises
    HframeError.
    """
    check_records(printer)
    limits = printer.limits
    for share in GENTLER:
        gentler = replace(
            limits, acceleration=share * limits.acceleration, jerk=share * limits.jerk
        )
        try:
            return _runs(replace(printer, limits=gentler))
        except LimitError as error:
            found = error
    raise HframeError(
        f"even with {GENTLER[-1]:g} of limits.acceleration the {found.quantity} of the compensated "
        f"test motion would be {found.value:.6g}, the printer's limit is {found.bound:.6g}. Raise "
        "the limits under [motors] if the motors can do it, or lower those under [limits]"
    )


def _runs(printer: Printer) -> list[PlannedRun]:
    options = Options("racking", limits="printer", clamp=False)
    stream = SampleStream(path(printer), printer, options, tuple(STRATEGIES.values()))
    chunks = [chunk for chunk in stream.computed() if len(chunk)]
    quiet, found = ((QUIET, QUIET), (0, 0)), list[PlannedRun]()
    for name, strategy in STRATEGIES.items():
        command = np.concatenate([chunk.commands[strategy] for chunk in chunks])
        start = float(command[0, X]), float(command[0, Y])
        found.append(PlannedRun(name, X, start, frozen(np.pad(command, quiet, mode="edge"))))
    return found


def motion_of(wanted: Array) -> slice:
    """Return which samples of a command (m, 2) are the test motion, without rests."""
    moving = np.flatnonzero((np.diff(wanted, axis=0) != 0.0).any(axis=1))
    return slice(int(moving[0]), int(moving[-1]) + 1)


LOW_HZ, FLAT_HZ, HIGH_HZ = 3.0, 6.0, 120.0  # band of the integration, complete from FLAT_HZ on
GAIN_HZ = (2.0, 9.0)  # slow motion, which any printer follows and any model predicts alike
HARMLESS_DELAY = 5e-3  # s of both axes alike: the nozzle is on the path, only later
COUPLED_HZ = (9.0, 100.0)  # in which racking can be distinguished from a rotated sensor


@dataclass(frozen=True, slots=True)
class Verdict:
    """What both recordings show; each pair is (plain, compensated).

    measured, predicted: contour error, µm RMS.
    unexplained: share of the nozzle's motion off its path that the model did not predict.
    coupling: what x and y do to each other, racking included, relative to the model's, and its
    standard deviation; None if the model has none. at (n,): s, of the contour
    errors (n,) in µm along the motion.
    """

    measured: Sequence[float]
    predicted: Sequence[float]
    unexplained: float
    coupling: tuple[float, float] | None
    at: Array
    errors_measured: Sequence[Array]
    errors_predicted: Sequence[Array]

    @property
    def reduction(self) -> float:
        return 1.0 - self.measured[1] / self.measured[0]

    @property
    def expected(self) -> float:
        return 1.0 - self.predicted[1] / self.predicted[0]

    @property
    def fault(self) -> str | None:
        """Return why the profile fails; None if it is good."""
        if self.reduction <= 0.0:
            return (
                "compensation makes this printer WORSE: the profile belongs to another printer, "
                "or the printer has changed. Do not print with it. Measure and identify again"
            )
        ratio, sd = self.coupling or (1.0, 0.0)
        if abs(ratio - 1.0) > verdict.COUPLING_ERROR + 3.0 * sd:
            how = "the other way, " if ratio < 0.0 else ""
            return (
                f"x and y move each other, as by racking, {how}{abs(ratio):.1f} times as far as "
                "the model predicts: files are exchanged, x_c is wrong, or this is another "
                "printer. Measure and identify again"
            )
        if self.unexplained > verdict.UNEXPLAINED_OFF_PATH:
            return (
                f"the model misses {100 * self.unexplained:.0f} % of the nozzle's motion off its "
                f"path, more than {100 * verdict.UNEXPLAINED_OFF_PATH:.0f} %: the profile is not "
                "that of this printer as it is now. Measure and identify again"
            )
        if self.reduction < max(verdict.REDUCTION, verdict.REDUCTION_OF_PREDICTED * self.expected):
            return (
                f"compensation removes {100 * self.reduction:.0f} % of the error, not the "
                f"{100 * self.expected:.0f} % that the model predicts. Measure and identify again"
            )
        return None

    def as_text(self) -> str:
        """Return a table for a person, with the verdict in its last line."""
        rows = [
            ("contour error measured", self.measured, "µm"),
            ("contour error predicted", self.predicted, "µm"),
        ]
        lines = [f"{'RMS':26s}{'plain':>10s}{'compensated':>14s}"]
        lines += [f"{name:26s}{a:10.1f}{b:14.1f}  {unit}" for name, (a, b), unit in rows]
        lines.append(f"{'model misses':26s}{100 * self.unexplained:10.0f} %")
        if self.coupling is not None:
            ratio, sd = self.coupling
            lines.append(f"{'coupling / model':26s}{ratio:10.2f} ± {sd:.2f}")
        good = f"good: compensation removes {100 * self.reduction:.0f} % of the error"
        words = f"FAILED: {self.fault}" if self.fault else good
        return "\n".join([*lines, f"VERDICT     {words}"])

    def as_json(self) -> dict[str, object]:
        pairs = {"measured_um": self.measured, "predicted_um": self.predicted}
        rounded = {
            name: {"plain": round(a, 3), "compensated": round(b, 3)}
            for name, (a, b) in pairs.items()
        }
        return {
            **rounded, "reduction": round(self.reduction, 4), "expected": round(self.expected, 4),
            "unexplained": round(self.unexplained, 4),
            "coupling": self.coupling and [round(one, 4) for one in self.coupling],
            "fault": self.fault,
        }  # fmt: skip


@dataclass(frozen=True, slots=True)
class MeasuredRun:
    """A run as measured: places (m, 2) measured and predicted, mm; accelerations (m, 2), mm/s².

    a_cross (m, 2): the part of a_predicted that x and y do to each other. noise: of a place, mm.
    """

    place: Array
    predicted: Array
    a: Array
    a_predicted: Array
    a_cross: Array
    noise: float


def both(found: Sequence[Run]) -> tuple[Run, Run]:
    """Return the plain and the compensated run. Raises IdentificationError unless there are both.

    found: in any order; of repetitions the last counts.
    """
    named = {name: run for run in found for name in STRATEGIES if name in run.name}
    if len(named) < len(STRATEGIES):
        raise IdentificationError(
            "not both recordings of 'hframe-post measure --for verify', verify-plain and "
            "verify-compensated. Give the folder with them and the commands"
        )
    plain, compensated = (named[name] for name in STRATEGIES)
    if len(plain.command) != len(compensated.command):
        raise IdentificationError(
            "the commands of the two motions differ in length: they were not written by the same "
            "'hframe-post measure --for verify'"
        )
    return plain, compensated


def compare_runs(printer: Printer, plain: Run, compensated: Run) -> Verdict:
    """Compare both runs. Raises IdentificationError if a recording does not follow its command."""
    wanted = plain.command
    inside = np.zeros(len(wanted), dtype=bool)
    inside[motion_of(wanted)] = True
    moving = (np.diff(wanted, axis=0, append=wanted[-1:]) != 0.0).any(axis=1) & inside
    at, a_path = np.flatnonzero(moving), _curved(wanted)
    runs = [measured_run(printer, run) for run in (plain, compensated)]
    measured = [1e3 * contour_error(wanted, run.place, at) for run in runs]
    predicted = [1e3 * contour_error(wanted, run.predicted, at) for run in runs]
    noise = [1e3 * run.noise for run in runs]
    band = (GAIN_HZ[1], HIGH_HZ)
    missed = band_rms((runs[0].a - runs[0].a_predicted)[inside], *band)
    off_path = band_rms((runs[0].a - a_path)[inside], *band)
    missed_share, coupling = missed / max(off_path, 1e-9), _coupling(runs, inside)
    return Verdict(
        [_rms(error, less) for error, less in zip(measured, noise, strict=True)],
        [_rms(error) for error in predicted],
        missed_share, coupling, np.asarray(TS * at), measured, predicted,
    )  # fmt: skip


def _rms(values: Array, noise: float = 0.0) -> float:
    return float(np.sqrt(max((values**2).mean() - noise**2, 0.0)))


def measured_run(printer: Printer, run: Run) -> MeasuredRun:
    """Return what a recording shows of its command. Raises IdentificationError."""
    command, shown = run.command, run.on_command_clock()
    predicted = nozzle(printer.plant, command[0], command)
    a_predicted = _curved(predicted)
    late, most = 0.0, HARMLESS_DELAY
    for _ in range(2):  # a delay disturbs what slow motion shows of the sensor
        earlier = np.exp(2j * np.pi * _hz(a_predicted) * late)
        a = _filtered(shown[:, :Z], earlier)
        a = a @ _correction(a, a_predicted)
        late = float(np.clip(late + _lag(a, a_predicted), -most, most))
    off = _filtered(a - a_predicted, _integrating_twice(_hz(a)))
    quiet = np.concatenate([off[200 : QUIET - 200], off[-QUIET + 500 : -200]])
    noise = float(np.sqrt((quiet**2).mean()))
    a_cross = _curved(predicted - nozzle(printer.plant.decoupled(), command[0], command))
    return MeasuredRun(predicted + off, predicted, a, a_predicted, a_cross, noise)


def _curved(places: Array) -> Array:
    """Return the accelerations (m, 2), mm/s², of places (m, 2)."""
    return np.column_stack([acceleration(places[:, k]) for k in (X, Y)])


def _coupling(runs: Sequence[MeasuredRun], inside: Flags) -> tuple[float, float] | None:
    """Return what couples relative to the prediction, and its standard deviation.

    Found by least squares over both runs; other errors of the model count as noise.
    """
    cross, missed = (
        np.concatenate([_within(a[inside], *COUPLED_HZ) for a in each])
        for each in zip(*((run.a_cross, run.a - run.a_predicted) for run in runs), strict=True)
    )
    moved = cross.any(axis=0)  # axes
    if not moved.any():
        return None
    known, wanted = cross[:, moved].ravel(), missed[:, moved].ravel()
    power = float(known @ known)
    excess = float(known @ wanted) / power
    independent = 2.0 * (COUPLED_HZ[1] - COUPLED_HZ[0]) * TS * len(wanted)
    variance = float(np.square(wanted - excess * known).sum()) / max(independent, 1.0)
    return 1.0 + excess, float(np.sqrt(variance / power))


def _correction(a: Array, wanted: Array) -> Array:
    """Return the matrix (2, 2) that removes the sensor's gains and rotation, from slow motion.

    Raises IdentificationError if it is too far from 1 for any sensor.
    """
    slow, true = (_within(values, *GAIN_HZ) for values in (a, wanted))
    matrix = np.linalg.lstsq(slow, true, rcond=None)[0]
    off = np.abs(matrix - np.eye(2)).max()
    if off > 0.1 + np.sin(np.radians(10.0)):  # a gain 10 % off, rotated by 10°
        raise IdentificationError(
            f"the recording differs from the command by {100 * off:.0f} % in slow motion: "
            "it is the recording of another run"
        )
    return np.asarray(matrix)


def _lag(a: Array, wanted: Array) -> float:
    """Return by how many seconds an acceleration is late, up to 40 Hz."""
    hz, n = _hz(a), next_fast_len(2 * len(a))
    inside = (hz > GAIN_HZ[0]) & (hz < 40.0)
    omega = 2.0 * np.pi * hz[inside]
    cross = (rfft(a, n, axis=0) * rfft(wanted, n, axis=0).conj()).sum(axis=1)[inside]
    weight = np.abs(cross)
    return float(-(weight * omega * np.angle(cross)).sum() / (weight * omega**2).sum())


def _integrating_twice(hz: Array) -> Array:
    """Return the gain from accelerations in mm/s² to places in mm, without low frequencies."""
    u = np.clip((hz - LOW_HZ) / (FLAT_HZ - LOW_HZ), 0.0, 1.0)
    kept = u * u * (3.0 - 2.0 * u) * (hz < HIGH_HZ)
    return np.asarray(-kept / np.maximum(2.0 * np.pi * hz, 1.0) ** 2)


def _hz(a: Array) -> Array:
    """Return the frequencies in Hz at which ``_filtered`` needs a gain."""
    return np.asarray(rfftfreq(next_fast_len(2 * len(a)), TS))


def _filtered(a: Array, gain: Array | Complex) -> Array:
    """Return signals (m, k), every 1 ms, behind a filter."""
    n = next_fast_len(2 * len(a))
    return np.asarray(irfft(rfft(a, n, axis=0) * gain[:, None], n, axis=0)[: len(a)])


def _within(a: Array, low: float, high: float) -> Array:
    hz = _hz(a)
    return _filtered(a, np.where((hz < low) | (hz > high), 0.0, 1.0))


def band_rms(a: Array, low: float, high: float) -> float:
    """Return the RMS of signals (m, k), every 1 ms, between two frequencies in Hz."""
    return _rms(np.linalg.norm(_within(a, low, high), axis=1))
