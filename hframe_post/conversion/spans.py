"""The print in spans that are computed apart, cut by a rule of the input alone.

A span ends before a retraction or lift, where the machine stands and a command has come to rest,
once it has lasted SECONDS as its plan has it. So what is written never depends on who computes
it. A print that never stops is one span.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from hframe_post.stream.types import Halt, Handling, Passthrough, Plan, Planned, Position, Standing

SECONDS = 240.0  # two stops longer by 80 ms each are nothing to it
MOST_ITEMS = 20_000  # of a span that is handed over whole
LONGEST = 4.0 * SECONDS  # of such a span
SURELY = 1.0  # mm of path that are never written without taking the machine over


@dataclass(frozen=True, slots=True)
class Beginning:
    """How a span finds the machine.

    place: x, y, z, e where it stands in the stream's hands, mm; None: in nobody's, as at the start.
    offset: of the user's G92, mm.
    """

    place: Position | None = None
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Span:
    """Planned items that are computed together.

    items: a tuple, unless the span is too long to be held; of all but the last, a Halt ends them.
    """

    beginning: Beginning
    items: Iterable[Planned]

    @property
    def held(self) -> bool:
        """Whether it can be handed to another process."""
        return isinstance(self.items, tuple)


class Spans:
    """Cuts a stream of planned items; iterate once, using up each span before the next."""

    def __init__(self, planned: Iterable[Planned]) -> None:
        self._source = iter(planned)
        self._beginning = Beginning()
        self._first: Planned | None = None  # of the span to come
        self._seconds = 0.0  # of the present span
        self._moved = False  # since the machine was last released

    def __iter__(self) -> Iterator[Span]:
        while (span := self._next()) is not None:
            yield span

    def _next(self) -> Span | None:
        beginning, items = self._beginning, list[Planned]()
        for item in self._rest():
            items.append(item)
            if self._seconds > LONGEST or len(items) > MOST_ITEMS:
                return Span(beginning, self._unheld(items))
        return Span(beginning, tuple(items)) if items else None

    def _unheld(self, items: list[Planned]) -> Iterator[Planned]:
        """The span to its end; what follows it is not known before."""
        yield from items
        items.clear()
        yield from self._rest()

    def _rest(self) -> Iterator[Planned]:
        """Items up to the end of the span, and a Halt if another one follows."""
        if self._first is not None:
            yield self._took(self._first)
            self._first = None
        for item in self._source:
            if isinstance(item, Standing) and self._moved and self._seconds >= SECONDS:
                self._first, self._seconds = item, 0.0
                self._beginning = Beginning(item.start, self._beginning.offset)
                yield Halt()
                return
            yield self._took(item)

    def _took(self, item: Planned) -> Planned:
        if isinstance(item, Plan):
            self._seconds += float((np.diff(item.s[item.ends]) / item.cruise).sum())
            self._moved |= bool(item.s[-1] > SURELY)
        elif isinstance(item, Passthrough):
            self._seconds += item.seconds
            if item.handling is Handling.RELEASE:
                self._beginning = Beginning(None, item.state.offset)
                self._moved = False
        return item
