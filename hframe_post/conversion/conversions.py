"""A print as G-code, as steps of the motors or as samples, each with its report.

G-code is written span by span, in this process or in several, with the same bytes.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import chain
from typing import TYPE_CHECKING

from hframe_post.arrays import Array
from hframe_post.conversion.ledger import Ledger, StepTally
from hframe_post.conversion.options import Options, first_line
from hframe_post.conversion.pipeline import Chain, Stages, stop_solvers
from hframe_post.conversion.print_report import Report
from hframe_post.conversion.spans import Span, Spans
from hframe_post.conversion.whole_file import PlannedFile, SampleStream
from hframe_post.errors import HframeError, PrinterError
from hframe_post.gcode.limits import with_motors
from hframe_post.model.strategies import Compensator
from hframe_post.prediction.windows import WHOLE
from hframe_post.printer.settings import Printer
from hframe_post.stream.tally import joined
from hframe_post.version import __version__
from hframe_post.writers.gcode import GcodeSummary, GcodeWriter
from hframe_post.writers.print_time import SUMMARY, Output, after_head, later
from hframe_post.writers.steps import StepGenerator
from hframe_post.writers.tables import MOTORS, Header, Note, StepFileWriter, tabulate

if TYPE_CHECKING:
    from concurrent.futures import Future, ProcessPoolExecutor
    from multiprocessing.context import BaseContext


class GcodeConversion:
    """A print as G-code for the printer's firmware."""

    def __init__(self, lines: Iterable[bytes], printer: Printer, options: Options) -> None:
        lines, printer = with_motors(lines, printer, options.limits)
        self._chain, self._stamp = Chain(printer, options), first_line(printer, options)
        self._source, self._ledger = PlannedFile(lines, self._chain), Ledger()

    def __iter__(self) -> Iterator[Output]:
        return after_head(self._pieces(), self._stamp, SUMMARY)

    def _pieces(self) -> Iterator[Output]:
        writer = SpanWriter(self._chain, self._chain.compensator)
        for span in writer.written(self._source.spans()):
            begun = self._ledger.duration
            for piece in span.output:
                yield later(piece, begun)
            self._ledger = joined(self._ledger, span.ledger)
        self._source.check_filament(self._ledger.written.filament)

    @property
    def times(self) -> tuple[float, float]:
        """Return the duration of the print so far as sliced and as converted, s."""
        return self._source.sliced_seconds, self._ledger.duration

    @cached_property
    def _report(self) -> Report:
        own, ledger, options = self._chain.firmware, self._ledger, self._chain.options
        report, code = self._source.report(ledger), own.code()
        return replace(
            report, extruder_limit=own.printer.limits.extruder_acceleration,
            lines_per_second=own.motion(options.tolerance).lines_per_second,
            notices=(*report.notices, *code.notices), when_stopped=code.when_stopped,
        )  # fmt: skip

    def report(self) -> Report:
        """Return the report, once the output was used up."""
        return self._report


@dataclass(slots=True)
class WrittenSpan:
    """Output of a span; the ledger is complete once the output was used up."""

    output: Iterable[Output]
    ledger: Ledger = field(default_factory=Ledger)


class SpanWriter:
    """Everything that is needed to write any span of a print."""

    def __init__(self, chain: Chain, compensator: Compensator) -> None:
        self.made_of = chain, compensator
        self._at_stops = stop_solvers(chain, compensator)

    def streamed(self, span: Span) -> WrittenSpan:
        """Return a span that is computed while its output is taken."""
        chain, compensator = self.made_of
        start, options, own = span.beginning, chain.options, chain.firmware
        stages = Stages(
            chain, compensator, at_stops=self._at_stops, printing=replace(start.printing),
            skip_slow=options.tolerance is not None, advance=start.advance,
            whole=0 if start.place else WHOLE,
        )  # fmt: skip
        rules = own.motion(options.tolerance)
        writer = GcodeWriter(
            options.strategy, rules, own.code(), place=start.place, offset=start.offset
        )
        result = WrittenSpan(())

        def output() -> Iterator[Output]:
            commands = stages.predicted(stages.commands(span.items))
            yield from writer.write(commands)
            result.ledger = replace(stages.ledger, written=writer.summary)

        result.output = output()
        return result

    def written(self, spans: Spans) -> Iterator[WrittenSpan]:
        """Yield all spans in order; use up each before the next.

        The options' jobs is the number of processes that write them.
        """
        source, jobs = iter(spans), self.made_of[0].options.jobs
        for first in source:
            if jobs > 1 and first.in_memory:
                break
            yield self.streamed(first)
        else:
            return
        # a print of one span needs no other processes, nor the modules that start them
        from concurrent.futures.process import BrokenProcessPool, ProcessPoolExecutor

        pool = ProcessPoolExecutor(jobs, _context(), _start_worker, self.made_of)
        try:
            yield from self._written_by(pool, chain([first], source), most_pending=jobs + 2)
        except BrokenProcessPool as broken:
            if broken.__cause__ is not None:  # no worker died: what one sent cannot be unpickled
                *_, cause, _ = str(broken.__cause__).splitlines()
                raise RuntimeError(
                    f"the result of a worker process cannot be read: {cause}"
                ) from None
            raise HframeError(
                "a worker process of this conversion was killed, perhaps for lack of memory; "
                "nothing was written. Try again with --jobs 1"
            ) from None
        finally:
            pool.shutdown(cancel_futures=True)

    def _written_by(
        self, pool: ProcessPoolExecutor, source: Iterator[Span], most_pending: int
    ) -> Iterator[WrittenSpan]:
        from concurrent.futures.process import BrokenProcessPool

        pending: deque[Future[WrittenSpan]] = deque()
        failure: HframeError | BrokenProcessPool | None = None
        while failure is None:
            try:
                span = next(source, None)
                if span is not None and span.in_memory:
                    pending.append(pool.submit(_write_in_worker, span))
            except (HframeError, BrokenProcessPool) as error:
                span, failure = None, error  # raised below, after what precedes it
            while len(pending) > (most_pending if span is not None and span.in_memory else 0):
                yield pending.popleft().result()
            if span is None:
                break
            if not span.in_memory:
                yield self.streamed(span)
        if failure is not None:
            raise failure


# ---------------------------------------------------------------------- worker processes

_writer: list[SpanWriter] = []  # the one of this worker


def _context() -> BaseContext:
    """Return how workers start: as copies of this process where that is safe, which is faster."""
    import multiprocessing

    return multiprocessing.get_context("fork" if sys.platform == "linux" else "spawn")


def _start_worker(chain: Chain, compensator: Compensator) -> None:
    """Leave interrupts to the parent, and end with it even if it is killed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    _writer[:] = [SpanWriter(chain, compensator)]


def _end_with_parent() -> None:
    import multiprocessing

    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _write_in_worker(span: Span) -> WrittenSpan:
    result = _writer[0].streamed(span)
    result.output = list(result.output)
    return result


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
            __version__, printer.name, options.digest(printer.digest), table.clock_hz,
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
        return replace(
            self._commands.report(), written=GcodeSummary(self._writer.lines, 0, self._filament),
            steps=StepTally(self._writer.rows, counts.ticks, self._table.clock_hz, motors),
        )  # fmt: skip


# ---------------------------------------------------------------------- samples


class SampleConversion:
    """A print as tables of path, command and predicted motion, one row a millisecond."""

    def __init__(self, lines: Iterable[bytes], printer: Printer, options: Options) -> None:
        self._plant, self._strategy = printer.plant, options.strategy
        self._commands = SampleStream(lines, printer, options)
        self._rows = 0

    def __iter__(self) -> Iterator[Array]:
        for table in tabulate(self._commands, self._strategy, self._plant):
            self._rows += len(table)
            yield table
        self._commands.check_filament(self._commands.ledger.filament_out)

    def report(self) -> Report:
        """Return the report; it is complete once the output was used up."""
        report = self._commands.report()
        return replace(report, written=GcodeSummary(self._rows, 0, report.filament_out))
