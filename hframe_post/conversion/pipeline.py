"""The whole river: lines → moves → plan → samples → commands → stops → safe → predicted.

``Commands`` joins the stages and sums up what each of them has seen. A conversion takes
commands to one kind of output, and its ``report`` is complete once the output is used up.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

from hframe_post.arrays import Array
from hframe_post.compensation.compensate import compensate
from hframe_post.compensation.guard import Clamp, Guard
from hframe_post.compensation.stops import rests, solvers, stand
from hframe_post.conversion.meters import Clock, ErrorMeter, FilamentMeter, InputMeter
from hframe_post.conversion.path_meter import PathMeter
from hframe_post.conversion.report import Report, StepReport
from hframe_post.errors import HframeError, PrinterError
from hframe_post.firmware.registry import player
from hframe_post.gcode.commands import STAMP
from hframe_post.gcode.options import Extrusion, FileLimits, ReadOptions
from hframe_post.gcode.reader import read
from hframe_post.model.course import Compensator
from hframe_post.planner.lookahead import plan
from hframe_post.planner.pacing import Paces, pace
from hframe_post.planner.sampling import sample
from hframe_post.printer.settings import Printer
from hframe_post.stream.prefetch import prefetch
from hframe_post.stream.types import Samples
from hframe_post.version import __version__
from hframe_post.writers.deferred import SUMMARY, Output
from hframe_post.writers.gcode import GcodeWriter
from hframe_post.writers.samples import tabulate
from hframe_post.writers.step_file import MOTORS, Header, Note, StepFileWriter
from hframe_post.writers.steps import Stepper

TOLERANCE = 0.014  # mm by which G-code may be off the computed command; the nozzle is by 1 µm RMS
FILAMENT_TOLERANCE = 1e-3  # mm over a whole print; more is an error, not a rounding


@dataclass(frozen=True, slots=True)
class Options:
    """What a user chooses beside the printer.

    strategy: what is written; predict: strategies whose contour error is reported;
    limits, extrusion: how the file is read, as in ``ReadOptions``; clamp: whether a command
    beyond a limit is taken back instead of being an error; tolerance: mm of decimation, None
    for every sample; paces: by what is printed, in place of the file's own.
    """

    strategy: str
    predict: tuple[str, ...] = ()
    limits: FileLimits = "file"
    clamp: bool = False
    tolerance: float | None = TOLERANCE
    extrusion: Extrusion | None = None
    paces: Paces | None = None

    @property
    def strategies(self) -> tuple[str, ...]:
        """Every strategy that must be computed."""
        return tuple(dict.fromkeys((self.strategy, *self.predict)))


class Commands:
    """Safe commands for the motors, one sample a millisecond, streaming in constant memory.

    strategies: whose commands are computed, where these are not just the options'. Iterating
    raises HframeError. ``report`` holds once everything has been taken.
    """

    def __init__(
        self,
        lines: Iterable[bytes],
        printer: Printer,
        options: Options,
        strategies: tuple[str, ...] = (),
        compensator: Compensator | None = None,
    ) -> None:
        self._lines, self._printer, self._options = lines, printer, options
        self._strategies = strategies or options.strategies
        self._compensator = compensator or prepared(printer)
        checked = (printer.travel, printer.motors, printer.kinematics)
        self._input, self._path = InputMeter(), PathMeter(printer.limits)
        self._clock = Clock()
        self._clamp, self._guard = Clamp(*checked), Guard(*checked)
        self._errors = ErrorMeter(printer.plant)

    def __iter__(self) -> Iterator[Samples]:
        """Computed ahead in threads of their own: one up to the guard, one for the prediction."""
        commands = prefetch(self.computed())
        if self._options.predict:
            commands = prefetch(self._errors.samples(commands))
        return self._clock.samples(commands)

    def computed(self) -> Iterator[Samples]:
        """The commands as they are computed: no thread, no prediction, no clock."""
        printer, options = self._printer, self._options
        limits = printer.limits
        lines = self._input.lines(self._lines)
        reading = ReadOptions.of(printer, options.limits, options.extrusion)
        items = self._input.items(read(lines, reading))
        if options.paces is not None:
            items = pace(items, options.paces)
        items = self._path.items(items)
        waits = rests(printer.compensation.stops, options.strategy)
        samples = sample(plan(items, limits), limits, waits)
        commands = compensate(samples, self._compensator, self._strategies)
        commands = stand(commands, solvers(self._compensator, self._strategies, printer))
        if options.clamp:
            commands = self._clamp.limit(commands, options.strategy)
        return self._guard.check(commands, options.strategy)

    @property
    def duration(self) -> float:
        """Of what has been taken, s."""
        return self._clock.time.after

    def report(self) -> Report:
        """What the stages saw."""
        return Report(
            self._options.strategy, self._input.summary, self._path.summary, self._clock.time,
            self._guard.peaks, self._clamp.clamped, self._errors.contour,
        )  # fmt: skip

    def conserved(self, filament: float, tolerance: float = FILAMENT_TOLERANCE) -> None:
        """Raises HframeError unless as much filament was written as was read, mm."""
        lost = self._input.summary.filament - filament
        if abs(lost) > tolerance:
            raise HframeError(f"{lost:.4f} mm of filament would be lost; nothing was written")


class GcodeConversion:
    """A print as G-code for the printer's firmware."""

    def __init__(self, lines: Iterable[bytes], printer: Printer, options: Options) -> None:
        self._printer, self._options = printer, options
        self._player = player(printer, options.tolerance)
        self.commands = Commands(lines, printer, options)
        self._writer = GcodeWriter(options.strategy, self._player)

    def __iter__(self) -> Iterator[Output]:
        yield b"%s %s\n" % (STAMP, stamp(self._printer, self._options).encode())
        yield SUMMARY
        yield from self._writer.write(self.commands)
        self.commands.conserved(self._writer.summary.filament)

    def report(self) -> Report:
        """Complete once the output has been used up."""
        written = self._writer.summary
        report = replace(
            self.commands.report(), lines_written=written.lines + 1,  # and the stamp
            filament_after=written.filament, busiest_second=written.busiest_second,
            lines_per_second=self._player.lines_per_second,
        )  # fmt: skip
        told = len(report.as_text().splitlines())  # the summary's own lines
        return replace(report, lines_written=written.lines + 1 + told)


class StepConversion:
    """A print as the steps of its motors: text of a step file, and notes for its events.

    kind: ``steps`` or ``step-bits``. Raises PrinterError where the profile does not say how the
    motors step.
    """

    def __init__(
        self, lines: Iterable[bytes], printer: Printer, options: Options, kind: str = "steps"
    ) -> None:
        table, kinematics = printer.steps, printer.kinematics
        if table is None:
            raise PrinterError("the table is missing: step timing needs it", "steps", printer.name)
        self._table = table
        self.commands = Commands(lines, printer, options)
        self._stepper = Stepper(options.strategy, kinematics, table)
        header = Header(
            kind, __version__, printer.name, settings_hash(printer, options), table.clock_hz,
            (table.belt, table.belt, table.z, table.e), kinematics.matrix,
        )  # fmt: skip
        self._writer = StepFileWriter(header)

    def __iter__(self) -> Iterator[bytes | Note]:
        yield from self._writer.write(self._stepper.step(self.commands))
        # a step that is not due yet at the end of a stretch is made in the next one
        late = self._stepper.counts.starts * self._table.e
        self.commands.conserved(self._filament, FILAMENT_TOLERANCE + late)

    @property
    def _filament(self) -> float:
        counts = self._stepper.counts
        return float(counts.net[MOTORS.index("E")] * self._table.e + counts.passed)

    def report(self) -> Report:
        """Complete once the output has been used up."""
        counts = self._stepper.counts
        motors = dict(zip(MOTORS, counts.steps.tolist(), strict=True))
        steps = StepReport(self._writer.rows, counts.ticks, self._table.clock_hz, motors)
        return replace(
            self.commands.report(), lines_written=self._writer.lines,
            filament_after=self._filament, steps=steps,
        )  # fmt: skip


class SampleConversion:
    """A print as tables of path, command and predicted motion, one row a millisecond."""

    def __init__(self, lines: Iterable[bytes], printer: Printer, options: Options) -> None:
        self._plant, self._strategy = printer.plant, options.strategy
        self.commands = Commands(lines, printer, options)
        self._filament, self._rows = FilamentMeter(), 0

    def __iter__(self) -> Iterator[Array]:
        for table in tabulate(self._filament.samples(self.commands), self._strategy, self._plant):
            self._rows += len(table)
            yield table
        self.commands.conserved(self._filament.total)

    def report(self) -> Report:
        """Complete once the output has been used up."""
        return replace(
            self.commands.report(), lines_written=self._rows, filament_after=self._filament.total
        )


Conversion = GcodeConversion | StepConversion | SampleConversion


def prepared(printer: Printer) -> Compensator:
    """The printer's compensator, certified. Raises PrinterError."""
    try:
        return Compensator(printer.plant, printer.compensation.windows)
    except ValueError as error:
        raise PrinterError(str(error), "compensation", printer.name) from None


def stamp(printer: Printer, options: Options) -> str:
    """Version, printer and settings: what made the output."""
    return f"{__version__}, printer {printer.name}, settings {settings_hash(printer, options)}"


def settings_hash(printer: Printer, options: Options) -> str:
    """Identifies all that decides the output beside the input."""
    deciding = (printer.digest, replace(options, predict=()))
    return hashlib.sha256(repr(deciding).encode()).hexdigest()[:12]
