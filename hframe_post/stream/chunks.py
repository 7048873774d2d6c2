"""Chunks of a stream of samples: parts, joins, batches, neighbours, stretches."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import chain
from typing import TypeVar

import numpy as np

from hframe_post.stream.types import Samples, frozen

T = TypeVar("T")


def stretches(chunks: Iterable[Samples]) -> Iterator[Iterator[Samples]]:
    """The stream in parts, each ending where the machine may move on its own: state ends there too.

    Each part must be used up before the next one is asked for.
    """
    source = iter(chunks)

    def stretch(chunk: Samples) -> Iterator[Samples]:
        yield chunk
        while not chunk.ends_stretch and (following := next(source, None)) is not None:
            chunk = following
            yield chunk

    for first in source:
        yield stretch(first)


def batches(chunks: Iterable[Samples], n: int) -> Iterator[Samples]:
    """Contiguous chunks cut anew, ``n`` samples each, the last one what is left."""
    held: list[Samples] = []
    for chunk in chunks:
        held.append(chunk)
        if sum(map(len, held)) < n:
            continue
        whole = join(held)
        cuts = range(0, len(whole) - n + 1, n)
        yield from (part(whole, k, k + n) for k in cuts)
        done = cuts[-1] + n
        held = [part(whole, done, len(whole))] if done < len(whole) else []
    if held:
        yield join(held)


def smaller(chunks: Iterable[Samples], n: int) -> Iterator[Samples]:
    """The same stream in chunks of at most ``n`` samples."""
    for chunk in chunks:
        for start in range(0, len(chunk), n):
            yield part(chunk, start, min(start + n, len(chunk)))
        if not len(chunk):
            yield chunk


def with_neighbours(
    chunks: Iterable[Samples], before: int, after: int
) -> Iterator[tuple[Samples, Samples, slice]]:
    """Each chunk, a wider one with up to so many samples around it, and where it lies there."""
    past: list[Samples] = []
    held: list[Samples] = []
    for chunk in chain(chunks, [None]):
        if chunk is not None:
            held.append(chunk)
        while held and (chunk is None or sum(map(len, held[1:])) >= after):
            current = held.pop(0)
            wide = join([*past, current, *_beginning(held, after)])
            start = sum(map(len, past))
            end = start + len(current)
            past = list(_ending([*past, current], before))
            yield current, wide, slice(start, end)


def _ending(chunks: list[Samples], n: int) -> Iterator[Samples]:
    """The last n samples."""
    more = sum(map(len, chunks)) - n
    for chunk in chunks:
        if more <= len(chunk):
            yield part(chunk, max(more, 0), len(chunk))
        more -= len(chunk)


def _beginning(chunks: list[Samples], n: int) -> Iterator[Samples]:
    """The first n samples."""
    for chunk in chunks:
        if n <= 0:
            return
        yield part(chunk, 0, min(n, len(chunk)))
        n -= len(chunk)


def join(chunks: list[Samples]) -> Samples:
    """Contiguous chunks as one."""
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
    )


def part(chunk: Samples, start: int, stop: int) -> Samples:
    """Samples start … stop − 1 of a chunk; the events of ``stop`` only if the chunk ends there."""
    low, high = chunk.first + start, chunk.first + stop
    events = tuple(
        e for e in chunk.events if low <= e.index and (e.index < high or high >= chunk.end)
    )
    commands = {name: xy[start:stop] for name, xy in chunk.commands.items()}
    ends = chunk.ends_stretch and high >= chunk.end
    return Samples(low, chunk.xyze[start:stop], chunk.line[start:stop], events, commands, ends)


def shifted(chunk: Samples, samples: int) -> Samples:
    """The chunk so much later."""
    if not samples:
        return chunk
    events = tuple(replace(event, index=event.index + samples) for event in chunk.events)
    return replace(chunk, first=chunk.first + samples, events=events)


def branches(chunks: Iterable[T], count: int) -> list[Iterator[T]]:
    """The same chunks ``count`` times over; held only until the slowest branch has taken them.

    ``itertools.tee`` lets go of what has been taken by dozens only, and a chunk is megabytes.
    """
    source, queues = iter(chunks), [deque[T]() for _ in range(count)]

    def branch(queue: deque[T]) -> Iterator[T]:
        while True:
            if not queue:
                chunk = next(source, None)
                if chunk is None:
                    return
                for other in queues:
                    other.append(chunk)
            yield queue.popleft()

    return [branch(queue) for queue in queues]
