"""Spans as G-code, here or in other processes; in order, and the same bytes either way."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
from collections import deque
from collections.abc import Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field

from hframe_post.compensation.stops import stop_solvers
from hframe_post.conversion.options import Options
from hframe_post.conversion.spans import Span
from hframe_post.conversion.stages import SpanSummary, Stages
from hframe_post.errors import HframeError
from hframe_post.firmware.registry import player
from hframe_post.model.strategies import Compensator
from hframe_post.printer.settings import Printer
from hframe_post.writers.stream.deferred import Output
from hframe_post.writers.stream.gcode import GcodeSummary, GcodeWriter

AHEAD = 2  # spans beyond one a process that are read before the first of them is written


@dataclass(slots=True)
class WrittenSpan:
    """A span's output in order, and what was seen once it has been used up."""

    output: Iterable[Output]
    seen: SpanSummary = field(default_factory=SpanSummary)
    written: GcodeSummary = field(default_factory=lambda: GcodeSummary(0, 0, 0.0))


class SpanWriter:
    """All that is needed to write any span of a print."""

    def __init__(self, printer: Printer, options: Options, compensator: Compensator) -> None:
        self.made_of = printer, options, compensator
        self._at_stops = stop_solvers(compensator, options.strategies, printer)

    def streamed(self, span: Span, threads: bool) -> WrittenSpan:
        """The span as it is computed, by threads or without."""
        printer, options, compensator = self.made_of
        stages = Stages(printer, options, compensator, options.strategies, self._at_stops)
        begun = span.beginning
        firmware = player(printer, options.tolerance, options.retract == "moving")
        writer = GcodeWriter(options.strategy, firmware, place=begun.place, offset=begun.offset)
        result = WrittenSpan(())

        def output() -> Iterator[Output]:
            judged = stages.judged(stages.computed(span.items), threads)
            yield from stages.times.timed("write", writer.write(judged))
            result.seen, result.written = stages.summary, writer.summary

        result.output = output()
        return result

    def whole(self, span: Span) -> WrittenSpan:
        """The span once all of it is written, its text in few pieces."""
        result = self.streamed(span, threads=False)
        result.output = _joined(result.output)
        return result

    def in_order(self, spans: Iterable[Span], jobs: int) -> Iterator[WrittenSpan]:
        """Every span, written by so many processes. Each must be used up before the next.

        What is wrong with an earlier span is raised before what is wrong further on in the file.
        """
        if jobs > 1:
            return _by_processes(self, spans, jobs)
        return (self.streamed(span, threads=True) for span in spans)


def _joined(output: Iterable[Output]) -> list[Output]:
    pieces: list[Output] = []
    text: list[bytes] = []
    for piece in output:
        if isinstance(piece, bytes):
            text.append(piece)
            continue
        pieces += [b"".join(text), piece]
        text.clear()
    return [*pieces, b"".join(text)]


def _by_processes(writer: SpanWriter, spans: Iterable[Span], jobs: int) -> Iterator[WrittenSpan]:
    waiting: deque[Future[WrittenSpan]] = deque()
    source, pool = _Reader(spans), None
    try:
        span = source.next()
        while span is not None:
            # a span is known to be the last, or too long to be held, when it is asked for
            following = source.next() if span.held else None
            alone = pool is None and following is None
            if not span.held or alone:
                yield from _results(waiting, 0)
                yield writer.streamed(span, threads=True)
                span = source.next() if not span.held else following
                continue
            pool = pool or _pool(writer, jobs)
            waiting.append(pool.submit(_whole, span))
            yield from _results(waiting, jobs + AHEAD)
            span = following
        yield from _results(waiting, 0)
        source.check()
    except BrokenProcessPool:
        raise HframeError(
            "a process of this conversion was ended, maybe for want of memory; nothing was "
            "written: try --jobs 1"
        ) from None
    finally:
        if pool is not None:
            pool.shutdown(cancel_futures=True)


def _results(waiting: deque[Future[WrittenSpan]], left: int) -> Iterator[WrittenSpan]:
    while len(waiting) > left:
        yield waiting.popleft().result()


class _Reader:
    """Reads ahead; an error is kept until everything before it has been written."""

    def __init__(self, spans: Iterable[Span]) -> None:
        self._spans, self._error = iter(spans), list[HframeError]()

    def next(self) -> Span | None:
        """The next span; None after the last, and where the file is wrong."""
        if self._error:
            return None
        try:
            return next(self._spans, None)
        except HframeError as error:
            self._error.append(error)
            return None

    def check(self) -> None:
        """Raises what was wrong."""
        if self._error:
            raise self._error[0]


# ---------------------------------------------------------------------- in another process

_writer: list[SpanWriter] = []  # of this process


def _pool(writer: SpanWriter, jobs: int) -> ProcessPoolExecutor:
    """Processes that are copies of this one where that is safe, which begin at once."""
    method = "fork" if sys.platform == "linux" else "spawn"
    context = multiprocessing.get_context(method)
    return ProcessPoolExecutor(jobs, context, _begin, writer.made_of)


def _begin(printer: Printer, options: Options, compensator: Compensator) -> None:
    """Interrupts are the parent's business, and without it there is none."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    _writer[:] = [SpanWriter(printer, options, compensator)]


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _whole(span: Span) -> WrittenSpan:
    return _writer[0].whole(span)
