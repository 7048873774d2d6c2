"""A print cut into spans, which are written as G-code in this process or in several.

A span ends before a retraction or lift, where the machine dwells and its command has come to rest,
once its plan has lasted SPAN_S: a rule that depends on the input alone. The output therefore does
not depend on who computes a span. A print that never stops is one span.
"""

from __future__ import annotations

import signal
import sys
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from itertools import accumulate
from typing import TYPE_CHECKING

import numpy as np

from hframe_post.arrays import Array
from hframe_post.conversion.ledger import Ledger
from hframe_post.conversion.pipeline import Beginning, Chain, Stages
from hframe_post.errors import HframeError
from hframe_post.firmware.dialect import NO_ADVANCE, Advance
from hframe_post.process import end_after
from hframe_post.stream.features import Place
from hframe_post.stream.marks import PLACES, SETS, Marks
from hframe_post.stream.types import (
    Handling,
    MoveAtRest,
    Passthrough,
    Plan,
    Planned,
    SpanEnd,
    Standing,
)
from hframe_post.writers.gcode import GcodeWriter
from hframe_post.writers.print_time import Output

if TYPE_CHECKING:
    from concurrent.futures import Future, ProcessPoolExecutor

SPAN_S = 240.0  # each cut costs some 0.1 s of print time
ARRAYS = ("line", "points", "s", "ends", "speed", "cruise", "acceleration")  # of a plan
MAX_ITEMS = 20_000  # of a span that is handed to a worker; bounds the memory


@dataclass(frozen=True, slots=True)
class Span:
    """Planned items that are computed together; a SpanEnd ends all spans but the last.

    items: a tuple, unless the span is too long to be kept in memory or the only one of its print.
    """

    beginning: Beginning
    items: Iterable[Planned]

    @property
    def in_memory(self) -> bool:
        """Return whether the span can be handed to a worker process."""
        return isinstance(self.items, tuple)

    def __reduce__(self) -> tuple[Callable[..., Span], tuple[object, ...]]:
        """Pickle the plans' arrays joined: one by one they would take as long as planning."""
        plans = [item for item in self.items if isinstance(item, Plan)]
        others = [None if isinstance(item, Plan) else item for item in self.items]
        parts = ([getattr(plan, name) for plan in plans] for name in ARRAYS)
        joined = [(np.concatenate(part), [*map(len, part)]) for part in parts if plans]
        marks = Marks.joined(plan.marks for plan in plans), [len(plan.marks) for plan in plans]
        rests = [(plan.rests, plan.standing) for plan in plans]
        return _unpickled, (self.beginning, others, joined, *marks, rests)


def _unpickled(
    beginning: Beginning,
    others: list[Planned | None],
    joined: list[tuple[Array, list[int]]],
    marks: Marks,
    counts: list[int],
    rests: list[tuple[bool, tuple[Standing, ...]]],
) -> Span:
    parts = (_cut(array, counts) for array, counts in joined)
    ends = accumulate(counts)
    of_plans = (marks.rows(end - n, end) for n, end in zip(counts, ends, strict=True))
    plans = map(Plan, *parts, of_plans, *zip(*rests, strict=True))
    return Span(beginning, tuple(next(plans) if item is None else item for item in others))


def _cut(array: Array, counts: list[int]) -> list[Array]:
    ends = accumulate(counts)
    return [array[end - n : end] for n, end in zip(counts, ends, strict=True)]


class Spans:
    """Cuts a stream of planned items; iterate once, and use up each span before the next.

    advance: pressure advance at the beginning.
    """

    def __init__(self, planned: Iterable[Planned], advance: Advance = NO_ADVANCE) -> None:
        self._source = iter(planned)
        self._beginning, self._printing = Beginning(advance=advance), Place()
        self._advance = advance
        self._first: Planned | None = None  # item of the next span
        self._seconds = 0.0  # of the present span
        self._moved = False  # since the output took control of the machine
        self._any = False  # whether a span has been yielded

    def __iter__(self) -> Iterator[Span]:
        while (span := self._next()) is not None:
            yield span

    def _next(self) -> Span | None:
        beginning, items = self._beginning, list[Planned]()
        for item in self._rest():
            items.append(item)
            if self._seconds > 4.0 * SPAN_S or len(items) > MAX_ITEMS:
                return Span(beginning, self._streamed(items))
        if not items:
            return None
        # for the only span of a print, a worker process would take longer to start than it saves
        only, self._any = not self._any and self._first is None, True
        return Span(beginning, iter(items) if only else tuple(items))

    def _streamed(self, items: list[Planned]) -> Iterator[Planned]:
        yield from items
        items.clear()
        yield from self._rest()

    def _rest(self) -> Iterator[Planned]:
        """Yield items up to the end of the span, and a SpanEnd if another span follows."""
        if self._first is not None:
            yield self._noted(self._first)
            self._first = None
        for item in self._source:
            if isinstance(item, MoveAtRest) and self._moved and self._seconds >= SPAN_S:
                self._first, self._seconds = item, 0.0
                offset, printing = self._beginning.offset, replace(self._printing)
                self._beginning = Beginning(item.start, offset, printing, self._advance)
                yield SpanEnd()
                return
            yield self._noted(item)

    def _noted(self, item: Planned) -> Planned:
        if isinstance(item, Plan):
            s = item.s[item.ends]
            self._seconds += float(((s[1:] - s[:-1]) / item.cruise).sum())
            self._moved |= bool(item.s[-1] > 1.0)  # so long a path always takes control
            self._read(item.marks)
        elif isinstance(item, Marks):
            self._read(item)
        elif isinstance(item, Passthrough):
            self._seconds += item.seconds
            self._printing.mark(item.text)
            self._advance = self._advance.after(item.text)
            if item.handling is Handling.RELEASE:
                self._beginning = Beginning(None, item.state.offset)
                self._moved = False
        return item

    def _read(self, marks: Marks) -> None:
        for mark in marks.of(PLACES):
            self._printing.mark(mark.text)
        for mark in marks.of(SETS):
            self._advance = self._advance.after(mark.text)


# ---------------------------------------------------------------------- spans as G-code


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
