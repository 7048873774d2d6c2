"""Cuts of a stream of samples: stretches, batches, neighbours, parts and joins."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import chain

import numpy as np

from hframe_post.arrays import Array
from hframe_post.stream.marks import Marks
from hframe_post.stream.types import Event, Samples, frozen


def stretches(chunks: Iterable[Samples]) -> Iterator[Iterator[Samples]]:
    """Yield the stream in parts, each up to where the machine may move on its own.

    State of a stage ends there, too. Use up each part before you ask for the next.
    """
    source = iter(chunks)

    def stretch(chunk: Samples) -> Iterator[Samples]:
        yield chunk
        while not chunk.ends_stretch and (following := next(source, None)) is not None:
            chunk = following
            yield chunk

    for first in source:
        yield stretch(first)


def ended(chunks: Iterable[Samples]) -> Iterator[Samples]:
    """Yield the stream as a whole stretch: stages begin again after its last chunk."""
    last: Samples | None = None
    for chunk in chunks:
        if last is not None:
            yield last
        last = chunk
    if last is not None:
        yield replace(last, ends_stretch=True)


def successive(streams: Iterable[Iterable[Samples]]) -> Iterator[Samples]:
    """Yield streams as one: each begins at the sample after those before it, not at its own 0."""
    first = end = 0
    for stream in streams:
        for chunk in stream:
            chunk = shifted(chunk, first)
            end = chunk.end
            yield chunk
        first = end


def batches(chunks: Iterable[Samples], n: int) -> Iterator[Samples]:
    waiting: list[Samples] = []
    for chunk in chunks:
        waiting.append(chunk)
        if sum(map(len, waiting)) < n:
            continue
        whole = join(waiting)
        cuts = range(0, len(whole) - n + 1, n)
        yield from (part(whole, k, k + n) for k in cuts)
        done = cuts[-1] + n
        waiting = [part(whole, done, len(whole))] if done < len(whole) else []
    if waiting:
        yield join(waiting)


def with_neighbours(
    chunks: Iterable[Samples], before: int, after: int
) -> Iterator[tuple[Samples, Samples, slice]]:
    """Yield each chunk, a wider one with samples before and after it, and its slice there."""
    for past, chunk, following in neighbours(chunks, before, after):
        start = sum(map(len, past))
        yield chunk, join([*past, chunk, *following]), slice(start, start + len(chunk))


def neighbours(
    chunks: Iterable[Samples], before: int, after: int
) -> Iterator[tuple[list[Samples], Samples, list[Samples]]]:
    """Yield each chunk between the pieces of others before it and after it."""
    past: list[Samples] = []
    waiting: list[Samples] = []
    for chunk in chain(chunks, [None]):
        if chunk is not None:
            waiting.append(chunk)
        while waiting and (chunk is None or sum(map(len, waiting[1:])) >= after):
            current = waiting.pop(0)
            yield past, current, list(_first(waiting, after))
            past = list(_last([*past, current], before))


def _first(chunks: list[Samples], n: int) -> Iterator[Samples]:
    for chunk in chunks:
        if n <= 0:
            return
        yield part(chunk, 0, min(n, len(chunk)))
        n -= len(chunk)


def _last(chunks: list[Samples], n: int) -> Iterator[Samples]:
    skip = sum(map(len, chunks)) - n
    for chunk in chunks:
        if skip <= len(chunk):
            yield part(chunk, max(skip, 0), len(chunk))
        skip -= len(chunk)


def join(chunks: list[Samples]) -> Samples:
    if len(chunks) == 1:
        return chunks[0]
    return Samples(
        chunks[0].first,
        frozen(np.concatenate([c.xyze for c in chunks])),
        np.concatenate([c.line for c in chunks]),
        tuple(event for c in chunks for event in c.events),
        {
            name: frozen(np.concatenate([c.commands[name] for c in chunks]))
            for name in chunks[0].commands
        },
        chunks[-1].ends_stretch,
        _advance(chunks),
        any(c.in_e for c in chunks),
    )


def _advance(chunks: list[Samples]) -> Array | None:
    if all(chunk.advance is None for chunk in chunks):
        return None
    zeros = (np.zeros((len(c), 2)) if c.advance is None else c.advance for c in chunks)
    return frozen(np.concatenate(list(zeros)))


def part(chunk: Samples, start: int, stop: int) -> Samples:
    """Return samples start … stop − 1; events at ``stop`` belong to it only at the chunk's end."""
    low, high = chunk.first + start, chunk.first + stop
    events = tuple(_between(chunk.events, low, high, high >= chunk.end))
    commands = {name: xy[start:stop] for name, xy in chunk.commands.items()}
    ends = chunk.ends_stretch and high >= chunk.end
    advance = None if chunk.advance is None else chunk.advance[start:stop]
    xyze, line = chunk.xyze[start:stop], chunk.line[start:stop]
    return Samples(low, xyze, line, events, commands, ends, advance, chunk.in_e)


def _between(events: Iterable[Event], low: int, high: int, to_end: bool) -> Iterator[Event]:
    """Yield the events at samples low … high − 1; to_end: those that follow, too."""
    for event in events:
        if isinstance(event, Marks):
            stop = len(event) if to_end else event.count_before(high)
            if (start := event.count_before(low)) < stop:
                yield event if stop - start == len(event) else event.rows(start, stop)
        elif low <= event.index and (event.index < high or to_end):
            yield event


def shifted(chunk: Samples, samples: int) -> Samples:
    if not samples:
        return chunk
    events = tuple(
        event.shifted(samples)
        if isinstance(event, Marks)
        else replace(event, index=event.index + samples)
        for event in chunk.events
    )
    return replace(chunk, first=chunk.first + samples, events=events)
