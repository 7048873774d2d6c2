"""A print as steps of the motors or as samples, each with its report."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

from hframe_post.arrays import Array
from hframe_post.conversion.meters import FilamentMeter
from hframe_post.conversion.options import Options
from hframe_post.conversion.pipeline import SampleStream, settings_hash
from hframe_post.conversion.report import Report, StepReport
from hframe_post.errors import PrinterError
from hframe_post.printer.settings import Printer
from hframe_post.version import __version__
from hframe_post.writers.steps import StepGenerator
from hframe_post.writers.tables import MOTORS, Header, Note, StepFileWriter, tabulate

# ---------------------------------------------------------------------- steps


class StepConversion:
    """A print as text of a step file and notes for its events.

    Raises PrinterError if the profile does not say how the motors step.
    """

    def __init__(self, lines: Iterable[bytes], printer: Printer, options: Options) -> None:
        table, kinematics = printer.steps, printer.kinematics
        if table is None:
            cause = "the table is missing; step timing needs it"
            raise PrinterError(cause, "steps", printer.name)
        if not kinematics.z_is_separate:
            cause = (
                f"the motor of z moves with x on a {kinematics.type}: its steps cannot be written"
            )
            raise PrinterError(cause, "kinematics.type", printer.name)
        self._table = table
        self._commands = SampleStream(lines, printer, options)
        self._stepper = StepGenerator(options.strategy, kinematics, table)
        header = Header(
            __version__, printer.name, settings_hash(printer, options), table.clock_hz,
            (table.belt, table.belt, table.z, table.e), kinematics.matrix,
        )  # fmt: skip
        self._writer = StepFileWriter(header)

    def __iter__(self) -> Iterator[bytes | Note]:
        yield from self._writer.write(self._stepper.step(self._commands))
        # a step that is not due at the end of a stretch is made in the next one
        late = self._stepper.counts.starts * self._table.e
        self._commands.check_filament(self._filament, late)

    @property
    def _filament(self) -> float:
        counts = self._stepper.counts
        return float(counts.net[MOTORS.index("E")] * self._table.e + counts.passed)

    def report(self) -> Report:
        """Return the report; it is complete once the output was used up."""
        counts = self._stepper.counts
        motors = dict(zip(MOTORS, counts.steps.tolist(), strict=True))
        steps = StepReport(self._writer.rows, counts.ticks, self._table.clock_hz, motors)
        return replace(
            self._commands.report(), lines_written=self._writer.lines,
            filament_after=self._filament, steps=steps,
        )  # fmt: skip


# ---------------------------------------------------------------------- samples


class SampleConversion:
    """A print as tables of path, command and predicted motion, one row a millisecond."""

    def __init__(self, lines: Iterable[bytes], printer: Printer, options: Options) -> None:
        self._plant, self._strategy = printer.plant, options.strategy
        self._commands = SampleStream(lines, printer, options)
        self._filament, self._rows = FilamentMeter(), 0

    def __iter__(self) -> Iterator[Array]:
        commands = self._filament.samples(self._commands)
        for table in tabulate(commands, self._strategy, self._plant):
            self._rows += len(table)
            yield table
        self._commands.check_filament(self._filament.total)

    def report(self) -> Report:
        """Return the report; it is complete once the output was used up."""
        filament = self._filament.total
        return replace(self._commands.report(), lines_written=self._rows, filament_after=filament)
