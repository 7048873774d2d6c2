"""Spans of a print written as G-code, in this process or in several, with the same bytes."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from itertools import chain as chained
from typing import TYPE_CHECKING

from hframe_post.conversion.ledger import Ledger
from hframe_post.conversion.pipeline import Chain, Stages, stop_models
from hframe_post.conversion.spans import Span
from hframe_post.errors import HframeError
from hframe_post.writers.gcode import GcodeWriter
from hframe_post.writers.print_time import Output

if TYPE_CHECKING:
    from concurrent.futures import Future, ProcessPoolExecutor
    from multiprocessing.context import BaseContext


@dataclass(slots=True)
class WrittenSpan:
    """Output of a span; the ledger is complete once the output was used up."""

    output: Iterable[Output] = ()
    ledger: Ledger = field(default_factory=Ledger)


class SpanWriter:
    """Everything that is needed to write any span of a print."""

    def __init__(self, chain: Chain) -> None:
        self._chain, self._at_stops = chain, stop_models(chain, chain.compensator)

    def streamed(self, span: Span) -> WrittenSpan:
        """Return a span that is computed while its output is taken."""
        chain, start, result = self._chain, span.beginning, WrittenSpan()
        options, own = chain.options, chain.firmware
        stages = Stages(chain, chain.compensator, at_stops=self._at_stops, beginning=start)
        writer = GcodeWriter(
            options.strategy, own.motion(options.tolerance), own.code(), place=start.place,
            offset=start.offset,
        )  # fmt: skip

        def output() -> Iterator[Output]:
            yield from writer.write(stages.predicted(stages.commands(span.items)))
            result.ledger = replace(stages.ledger, written=writer.summary)

        result.output = output()
        return result

    def written(self, spans: Iterable[Span]) -> Iterator[WrittenSpan]:
        """Yield all spans in order; use up each before the next.

        The options' jobs is the number of processes that write them.
        """
        source, jobs = iter(spans), self._chain.options.jobs
        for first in source:
            if jobs > 1 and first.in_memory:
                break
            yield self.streamed(first)
        else:
            return
        # a print of one span needs no other processes, nor the modules that start them
        from concurrent.futures.process import BrokenProcessPool, ProcessPoolExecutor

        pool = ProcessPoolExecutor(jobs, _context(), _start_worker, (self._chain,))
        try:
            yield from self._written_by(pool, chained([first], source), most_pending=jobs + 2)
        except BrokenProcessPool:
            raise HframeError(
                "a worker process of this conversion was killed, perhaps for lack of memory; "
                "nothing was written. Try again with --jobs 1"
            ) from None
        finally:
            pool.shutdown(cancel_futures=True)

    def _written_by(
        self, pool: ProcessPoolExecutor, source: Iterator[Span], most_pending: int
    ) -> Iterator[WrittenSpan]:
        pending: deque[Future[WrittenSpan]] = deque()
        for span in chained(_faults_as_items(source), [None]):
            here = not isinstance(span, Span) or not span.in_memory
            if isinstance(span, Span) and not here:
                pending.append(pool.submit(_write_in_worker, span))
            while len(pending) > (0 if here else most_pending):
                yield pending.popleft().result()
            if isinstance(span, HframeError):
                raise span
            if isinstance(span, Span) and here:
                yield self.streamed(span)


def _faults_as_items(spans: Iterator[Span]) -> Iterator[Span | HframeError]:
    """Yield the spans, and what is wrong with the file behind those that precede it."""
    try:
        yield from spans
    except HframeError as error:
        yield error


# ---------------------------------------------------------------------- worker processes

_writer: list[SpanWriter] = []  # the one of this worker


def _context() -> BaseContext:
    """Return how workers start: as copies of this process where that is safe, which is faster."""
    import multiprocessing

    return multiprocessing.get_context("fork" if sys.platform == "linux" else "spawn")


def _start_worker(chain: Chain) -> None:
    """Leave interrupts to the parent, and end with it even if it is killed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    _writer[:] = [SpanWriter(chain)]


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
