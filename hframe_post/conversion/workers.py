"""Spans of a print written as G-code, in this process or in several, with the same bytes."""

from __future__ import annotations

import signal
import sys
from collections import deque
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from hframe_post.conversion.ledger import Ledger
from hframe_post.conversion.pipeline import Chain, Stages
from hframe_post.conversion.spans import Span
from hframe_post.errors import HframeError
from hframe_post.process import end_after
from hframe_post.writers.gcode import GcodeWriter
from hframe_post.writers.print_time import Output

if TYPE_CHECKING:
    from concurrent.futures import Future, ProcessPoolExecutor


@dataclass(slots=True)
class WrittenSpan:
    """Output of a span; the ledger is complete once the output was used up."""

    output: Iterable[Output] = ()
    ledger: Ledger = field(default_factory=Ledger)


def streamed(chain: Chain, span: Span) -> WrittenSpan:
    """Return a span that is computed while its output is taken."""
    options, own, start, result = chain.options, chain.firmware, span.beginning, WrittenSpan()
    stages = Stages(chain, beginning=start)
    writer = GcodeWriter(
        options.strategy, own.motion(options.tolerance), own.code(), place=start.place,
        offset=start.offset, played=stages.played.get(options.strategy),
    )  # fmt: skip

    def output() -> Iterator[Output]:
        yield from writer.write(stages.predicted(stages.commands(span.items)))
        result.ledger = replace(stages.ledger(), written=writer.summary)

    result.output = output()
    return result


def written(chain: Chain, spans: Iterable[Span]) -> Iterator[WrittenSpan]:
    """Yield all spans in order; use up each before the next.

    The options' jobs is the number of processes that write them. A fault of the file is raised
    after the spans before it, which may have one, too.
    """
    source, jobs, fault = iter(spans), chain.options.jobs, None
    pool: ProcessPoolExecutor | None = None
    pending: deque[Future[WrittenSpan]] = deque()
    with ExitStack() as ended:
        while True:
            try:
                span = next(source, None)
            except HframeError as error:
                span, fault = None, error
            apart = False
            if span is not None and jobs > 1 and span.in_memory:
                apart = True
                pool = pool or ended.enter_context(_processes(chain))
                pending.append(pool.submit(_write_in_worker, span))
            while len(pending) > (jobs + 2 if apart else 0):
                yield pending.popleft().result()
            if fault is not None:
                raise fault
            if span is None:
                return
            if not apart:
                yield streamed(chain, span)


# ---------------------------------------------------------------------- worker processes

_chain: list[Chain] = []  # the one of this worker


@contextmanager
def _processes(chain: Chain) -> Iterator[ProcessPoolExecutor]:
    """Start workers: as copies of this process where that is safe, which is faster."""
    # a print of one span needs no other processes, nor the modules that start them
    import multiprocessing
    from concurrent.futures.process import BrokenProcessPool, ProcessPoolExecutor

    _ = chain.at_stops  # which a copy then has
    context = multiprocessing.get_context("fork" if sys.platform == "linux" else "spawn")
    pool = ProcessPoolExecutor(chain.options.jobs, context, _start_worker, (chain,))
    try:
        yield pool
    except BrokenProcessPool:
        raise HframeError(
            "a worker process of this conversion was killed, perhaps for lack of memory; "
            "nothing was written. Try again with --jobs 1"
        ) from None
    finally:
        pool.shutdown(cancel_futures=True)


def _start_worker(chain: Chain) -> None:
    """Leave interrupts to the parent, and end with it even if it is killed."""
    import multiprocessing

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    if (parent := multiprocessing.parent_process()) is not None:
        end_after(parent.join)
    _chain[:] = [chain]


def _write_in_worker(span: Span) -> WrittenSpan:
    result = streamed(_chain[0], span)
    result.output = list(result.output)
    return result
