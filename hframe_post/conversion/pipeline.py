"""The whole river: lines → moves → plan → samples → commands → stops → safe → predicted.

``Commands`` joins the stages and sums up what each of them has seen. A conversion takes
commands to one kind of output, and its ``report`` is complete once the output is used up.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator
from dataclasses import replace

from hframe_post.arrays import Array
from hframe_post.compensation.guard import check_model, check_prediction
from hframe_post.conversion.meters import FilamentMeter, InputMeter
from hframe_post.conversion.options import TOLERANCE as TOLERANCE
from hframe_post.conversion.options import Options as Options
from hframe_post.conversion.path_meter import PathMeter
from hframe_post.conversion.report import Report, StepReport
from hframe_post.conversion.span_writer import SpanWriter
from hframe_post.conversion.spans import Spans
from hframe_post.conversion.stages import SpanSummary, Stages
from hframe_post.errors import HframeError, PrinterError
from hframe_post.firmware.registry import player
from hframe_post.gcode.commands import STAMP
from hframe_post.gcode.options import ReadOptions
from hframe_post.gcode.reader import read
from hframe_post.model.strategies import Compensator
from hframe_post.planner.lookahead import plan
from hframe_post.planner.pacing import pace
from hframe_post.printer.settings import Printer
from hframe_post.stream.chunks import shifted
from hframe_post.stream.timing import StageTimes, joined
from hframe_post.stream.types import Samples
from hframe_post.version import __version__
from hframe_post.writers.samples import tabulate
from hframe_post.writers.steps.file import MOTORS, Header, Note, StepFileWriter
from hframe_post.writers.steps.stepper import Stepper
from hframe_post.writers.stream.deferred import SUMMARY, Output, later
from hframe_post.writers.stream.gcode import GcodeSummary

FILAMENT_TOLERANCE = 1e-3  # mm over a whole print; more is an error, not a rounding


class _Source:
    """The file as spans of planned items, and what was seen of it."""

    def __init__(self, lines: Iterable[bytes], printer: Printer, options: Options) -> None:
        self._lines, self._printer, self._options = lines, printer, options
        self._input = InputMeter()
        self._path = PathMeter(printer.limits, options.paces is not None)
        self._times = StageTimes()

    def spans(self) -> Spans:
        """To be computed one after the other. Raises HframeError."""
        reading = ReadOptions.from_printer(
            self._printer, self._options.limits, self._options.extrusion
        )
        items = self._input.items(read(self._input.lines(self._lines), reading))
        items = self._times.timed("read", items)
        if self._options.paces is not None:
            items = pace(items, self._options.paces)
        planned = plan(self._path.items(items), self._printer.limits)
        return Spans(self._times.timed("plan", planned))

    def report(self, seen: SpanSummary) -> Report:
        """What the stages saw. Raises HframeError where the prediction cannot be right."""
        if "none" in seen.contour:
            check_prediction(seen.contour["none"].rms)
        return Report(
            self._options.strategy, self._input.summary, self._path.summary, seen.time, seen.peaks,
            seen.clamped, seen.contour, seconds=joined(self._times.seconds, seen.seconds),
        )  # fmt: skip

    def conserved(self, filament: float, tolerance: float = FILAMENT_TOLERANCE) -> None:
        """Raises HframeError unless as much filament was written as was read, mm."""
        lost = self._input.summary.filament - filament
        if abs(lost) > tolerance:
            raise HframeError(f"{lost:.4f} mm of filament would be lost; nothing was written")


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
        self._source = _Source(lines, printer, options)
        compensator = compensator or prepared(printer)
        self._stages = Stages(printer, options, compensator, strategies or options.strategies)
        self.conserved = self._source.conserved

    def __iter__(self) -> Iterator[Samples]:
        """Computed ahead in threads of their own: one up to the guard, one for the prediction."""
        return self._stages.judged(self.computed(), threads=True)

    def computed(self) -> Iterator[Samples]:
        """The commands as they are computed: no thread, no prediction, no clock."""
        first = end = 0
        for span in self._source.spans():
            for chunk in self._stages.computed(span.items):
                yield shifted(chunk, first)
                end = first + chunk.end
            first = end

    @property
    def duration(self) -> float:
        """Of what has been taken, s."""
        return self._stages.summary.time.after

    def report(self) -> Report:
        """What the stages saw."""
        return self._source.report(self._stages.summary)


class GcodeConversion:
    """A print as G-code for the printer's firmware.

    jobs: processes that compute it; the output does not depend on them.
    """

    def __init__(
        self, lines: Iterable[bytes], printer: Printer, options: Options, jobs: int = 1
    ) -> None:
        self._printer, self._options, self._jobs = printer, options, jobs
        self._player = player(printer, options.tolerance)
        self._source = _Source(lines, printer, options)
        self._seen, self._written = SpanSummary(), GcodeSummary(0, 0, 0.0)

    def __iter__(self) -> Iterator[Output]:
        yield b"%s %s\n" % (STAMP, stamp(self._printer, self._options).encode())
        yield SUMMARY
        writer = SpanWriter(self._printer, self._options, prepared(self._printer))
        for span in writer.in_order(self._source.spans(), self._jobs):
            begun = self.duration
            for piece in span.output:
                yield later(piece, begun)
            self._seen.join(span.seen)
            self._written = self._written.joined(span.written)
        self._source.conserved(self._written.filament)

    @property
    def duration(self) -> float:
        """Of what has been written, s."""
        return self._seen.time.after

    def report(self) -> Report:
        """Complete once the output has been used up."""
        written = self._written
        report = replace(
            self._source.report(self._seen), lines_written=written.lines + 1,  # and the stamp
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
        if not kinematics.z_is_separate:
            cause = f"the motor of z moves with x on a {kinematics.type}: its steps are not written"
            raise PrinterError(cause, "kinematics.type", printer.name)
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
    check_model(printer)
    try:
        return Compensator(printer.plant, printer.compensation.windows)
    except ValueError as error:
        raise PrinterError(str(error), "compensation", printer.name) from None


def stamp(printer: Printer, options: Options) -> str:
    """Version, printer and settings: what made the output."""
    return f"{__version__}, printer {printer.name}, settings {settings_hash(printer, options)}"


def settings_hash(printer: Printer, options: Options) -> str:
    """Identifies all that decides the output beside the input.

    Paces follow from the input and from the speed that is asked for.
    """
    deciding = (printer.digest, replace(options, predict=(), paces=None))
    return hashlib.sha256(repr(deciding).encode()).hexdigest()[:12]
