"""A print as G-code, as steps of the motors or as samples, each with its report."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

from hframe_post.arrays import Array
from hframe_post.conversion.ledger import StepTally
from hframe_post.conversion.options import Options, first_line
from hframe_post.conversion.whole_file import Commands, WholeFile
from hframe_post.conversion.workers import SpanWriter
from hframe_post.errors import PrinterError
from hframe_post.printer.settings import Printer
from hframe_post.stream.tally import joined
from hframe_post.version import __version__
from hframe_post.writers.gcode import GcodeSummary
from hframe_post.writers.print_time import SUMMARY, Output, after_head, later
from hframe_post.writers.steps import StepGenerator
from hframe_post.writers.tables import MOTORS, Header, Note, StepFileWriter, tabulate


class GcodeConversion(WholeFile):
    """A print as G-code for the printer's firmware, written span by span."""

    played = True

    def __iter__(self) -> Iterator[Output]:
        stamped = first_line(self.printer, self.chain.options)
        return after_head(self._pieces(), stamped, SUMMARY)

    def _pieces(self) -> Iterator[Output]:
        for span in SpanWriter(self.chain).written(self.spans):
            begun = self.done.duration
            for piece in span.output:
                yield later(piece, begun)
            self.done = joined(self.done, span.ledger)
        self.check_filament(self.done.written.filament)


class StepConversion(Commands):
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
        super().__init__(lines, printer, options)
        self._table = table
        self._stepper = StepGenerator(options.strategy, kinematics, table)
        self._writer = StepFileWriter(Header(
            __version__, printer.name, options.digest(printer.digest), table.clock_hz,
            (table.belt, table.belt, table.z, table.e), kinematics.matrix,
        ))  # fmt: skip

    def __iter__(self) -> Iterator[bytes | Note]:
        yield from self._writer.write(self._stepper.step(self.predicted()))
        counts, table = self._stepper.counts, self._table
        filament = float(counts.net[MOTORS.index("E")] * table.e + counts.passed)
        motors = dict(zip(MOTORS, counts.steps.tolist(), strict=True))
        self.done = replace(
            self.done, written=GcodeSummary(self._writer.lines, 0, filament),
            steps=StepTally(self._writer.rows, counts.ticks, table.clock_hz, motors),
        )  # fmt: skip
        # a step that is not due at the end of a stretch is made in the next one
        self.check_filament(filament, late=counts.starts * table.e)


class SampleConversion(Commands):
    """A print as tables of path, command and predicted motion, one row a millisecond."""

    def __iter__(self) -> Iterator[Array]:
        chain, rows = self.chain, 0
        for table in tabulate(self.predicted(), chain.options.strategy, chain.printer.plant):
            rows += len(table)
            yield table
        filament = self.done.filament_out
        self.done = replace(self.done, written=GcodeSummary(rows, 0, filament))
        self.check_filament(filament)
