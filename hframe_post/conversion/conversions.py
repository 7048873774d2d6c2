"""A print as G-code, written span by span, in this process or in several, with the same bytes."""

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

from hframe_post.compensation.stops import StopSolvers
from hframe_post.conversion.meters import MotionSummary
from hframe_post.conversion.options import Options
from hframe_post.conversion.pipeline import PlannedFile, Stages, first_line, prepared
from hframe_post.conversion.report import Report
from hframe_post.conversion.spans import Span, Spans
from hframe_post.errors import HframeError
from hframe_post.firmware.registry import firmware
from hframe_post.gcode.motors import with_motors
from hframe_post.model.strategies import Compensator
from hframe_post.prediction.windows import WHOLE
from hframe_post.printer.settings import Printer
from hframe_post.writers.gcode import GcodeSummary, GcodeWriter
from hframe_post.writers.print_time import SUMMARY, Output, after_head, later

if TYPE_CHECKING:
    from concurrent.futures import Future, ProcessPoolExecutor
    from multiprocessing.context import BaseContext


class GcodeConversion:
    """A print as G-code for the printer's firmware."""

    def __init__(self, lines: Iterable[bytes], printer: Printer, options: Options) -> None:
        lines, printer = with_motors(lines, printer, options.limits)
        self._printer, self._options = printer, options
        own = firmware(printer)
        self._rules, self._code = own.motion(options.tolerance), own.code()
        self._source = PlannedFile(lines, printer, options)
        self._motion, self._written = MotionSummary(), GcodeSummary()

    def __iter__(self) -> Iterator[Output]:
        stamp = first_line(self._printer, self._options)
        return after_head(self._pieces(), stamp, SUMMARY)

    def _pieces(self) -> Iterator[Output]:
        writer = SpanWriter(self._printer, self._options, prepared(self._printer))
        for span in writer.written(self._source.spans()):
            begun = self._motion.duration
            for piece in span.output:
                yield later(piece, begun)
            self._motion.join(span.motion)
            self._written = self._written.joined(span.written)
        self._source.check_filament(self._written.filament)

    @property
    def times(self) -> tuple[float, float]:
        """Return the duration of the print so far as sliced and as converted, s."""
        return self._source.sliced_seconds, self._motion.duration

    @cached_property
    def _report(self) -> Report:
        written = self._written
        report = self._source.report(self._motion)
        report = replace(
            report, lines_written=written.lines + 1,  # and the stamp
            filament_after=written.filament, busiest_second=written.busiest_second,
            sliced_off=self._source.sliced_off() if written.off else 0.0,
            lines_per_second=self._rules.lines_per_second, approximation=written.off,
            advance=self._source.advance(self._motion.advance),
            notices=(*report.notices, *self._code.notices), when_stopped=self._code.when_stopped,
        )  # fmt: skip
        of_summary = len(report.as_text().splitlines())
        return replace(report, lines_written=written.lines + 1 + of_summary)

    def report(self) -> Report:
        """Return the report, once the output was used up."""
        return self._report


@dataclass(slots=True)
class WrittenSpan:
    """Output of a span; the summaries are complete once the output was used up."""

    output: Iterable[Output]
    motion: MotionSummary = field(default_factory=MotionSummary)
    written: GcodeSummary = field(default_factory=GcodeSummary)


class SpanWriter:
    """Everything that is needed to write any span of a print."""

    def __init__(self, printer: Printer, options: Options, compensator: Compensator) -> None:
        self.made_of = printer, options, compensator
        self._at_stops = StopSolvers(compensator, options.strategies, printer)

    def streamed(self, span: Span, threads: bool = True) -> WrittenSpan:
        """Return a span that is computed while its output is taken."""
        printer, options, compensator = self.made_of
        start = span.beginning
        stages = Stages(
            printer, options, compensator, at_stops=self._at_stops,
            printing=replace(start.printing), skip_slow=options.tolerance is not None,
            advance=start.advance, whole=0 if start.place else WHOLE,
        )  # fmt: skip
        own = firmware(printer)
        rules = own.motion(options.tolerance, options.retract == "moving")
        writer = GcodeWriter(
            options.strategy, rules, own.code(), place=start.place, offset=start.offset
        )
        result = WrittenSpan(())

        def output() -> Iterator[Output]:
            commands = stages.predicted(stages.commands(span.items), threads)
            yield from stages.times.timed("write", writer.write(commands))
            result.motion, result.written = stages.summary, writer.summary

        result.output = output()
        return result

    def written(self, spans: Spans) -> Iterator[WrittenSpan]:
        """Yield all spans in order; use up each before the next.

        The options' jobs is the number of processes that write them.
        """
        source, jobs = iter(spans), self.made_of[1].jobs
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


def _start_worker(printer: Printer, options: Options, compensator: Compensator) -> None:
    """Leave interrupts to the parent, and end with it even if it is killed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    _writer[:] = [SpanWriter(printer, options, compensator)]


def _end_with_parent() -> None:
    import multiprocessing

    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _write_in_worker(span: Span) -> WrittenSpan:
    result = _writer[0].streamed(span, threads=False)
    result.output = list(result.output)
    return result
