"""Re-cutting of blocks of samples: parts, joins, batches, neighbours, stretches."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from itertools import chain

import numpy as np

from hframe_post.stream.types import Samples, frozen


def stretches(blocks: Iterable[Samples]) -> Iterator[Iterator[Samples]]:
    """The stream in parts, each ending where the machine is yielded: state ends there too.

    Each part must be used up before the next one is asked for.
    """
    source = iter(blocks)

    def stretch(block: Samples) -> Iterator[Samples]:
        yield block
        while not block.yields and (following := next(source, None)) is not None:
            block = following
            yield block

    for first in source:
        yield stretch(first)


def batches(blocks: Iterable[Samples], n: int) -> Iterator[Samples]:
    """Contiguous blocks cut anew, ``n`` samples each, the last one what is left."""
    held: list[Samples] = []
    for block in blocks:
        held.append(block)
        if sum(map(len, held)) < n:
            continue
        whole = join(held)
        cuts = range(0, len(whole) - n + 1, n)
        yield from (part(whole, k, k + n) for k in cuts)
        held = [part(whole, cuts[-1] + n, len(whole))]
    if held:
        yield join(held)


def with_neighbours(
    blocks: Iterable[Samples], before: int, after: int
) -> Iterator[tuple[Samples, Samples, slice]]:
    """Each block, a wider one with up to so many samples around it, and where it lies there."""
    past: Samples | None = None
    held: list[Samples] = []
    for block in chain(blocks, [None]):
        if block is not None:
            held.append(block)
        while held and (block is None or sum(map(len, held[1:])) >= after):
            current = held.pop(0)
            parts = [current] if past is None else [past, current]
            start = len(parts[0]) if past is not None else 0
            wide = join(parts)
            past = part(wide, max(len(wide) - before, 0), len(wide))
            if held:
                later = join(held)
                wide = join([wide, part(later, 0, min(after, len(later)))])
            yield current, wide, slice(start, start + len(current))


def join(blocks: list[Samples]) -> Samples:
    """Contiguous blocks as one."""
    if len(blocks) == 1:
        return blocks[0]
    return Samples(
        blocks[0].first,
        frozen(np.concatenate([b.xyze for b in blocks])),
        np.concatenate([b.line for b in blocks]),
        tuple(event for b in blocks for event in b.events),
        {
            name: frozen(np.concatenate([b.commands[name] for b in blocks]))
            for name in blocks[0].commands
        },
    )


def part(block: Samples, start: int, stop: int) -> Samples:
    """Samples start … stop − 1 of a block; the events of ``stop`` only if the block ends there."""
    low, high = block.first + start, block.first + stop
    events = tuple(
        e for e in block.events if low <= e.index and (e.index < high or high >= block.end)
    )
    commands = {name: xy[start:stop] for name, xy in block.commands.items()}
    return Samples(low, block.xyze[start:stop], block.line[start:stop], events, commands)


def branches(blocks: Iterable[Samples], count: int) -> list[Iterator[Samples]]:
    """The same blocks ``count`` times over; held only until the slowest branch has taken them.

    ``itertools.tee`` lets go of what has been taken by dozens only, and a block is megabytes.
    """
    source, queues = iter(blocks), [deque[Samples]() for _ in range(count)]

    def branch(queue: deque[Samples]) -> Iterator[Samples]:
        while True:
            if not queue:
                block = next(source, None)
                if block is None:
                    return
                for other in queues:
                    other.append(block)
            yield queue.popleft()

    return [branch(queue) for queue in queues]
