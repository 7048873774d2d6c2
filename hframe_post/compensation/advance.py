"""How far the extruder is ahead of the path: pressure advance, as the firmware or we make it.

The nozzle is on the path at the path's own time, whatever the command does. So advance follows from
the path, and is the same for all strategies.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np

from hframe_post.arrays import TS, Array, Integers
from hframe_post.firmware.advance import Advance, ExtruderLimits
from hframe_post.model.advance import NEAR, REACH, bounded, smoothed
from hframe_post.printer.settings import LONGEST_SMOOTHING
from hframe_post.stream.chunks import neighbours, stretches
from hframe_post.stream.types import Dwell, Mark, Passthrough, Samples, frozen

AROUND = REACH + NEAR + round(LONGEST_SMOOTHING / TS / 2.0)  # samples on which advance depends


class Advancing:
    """Adds advance to samples. ``least``, ``most``: s of it, wherever there are samples.

    advance: in force before the first. limits: of an extruder whose E must contain its
    advance; None: the firmware adds its own, and this is what it does.
    """

    def __init__(self, advance: Advance, limits: ExtruderLimits | None) -> None:
        self._limits = limits
        self._since = [(0, advance)]  # in force from these samples on, as far as they are needed
        self.least, self.most = math.inf, 0.0

    def samples(self, chunks: Iterable[Samples]) -> Iterator[Samples]:
        """Yield the chunks with their advance."""
        for stretch in stretches(self._noted(chunks)):
            for before, chunk, after in neighbours(stretch, AROUND, AROUND):
                yield self._advanced(before, chunk, after) if len(chunk) else chunk

    def _noted(self, chunks: Iterable[Samples]) -> Iterator[Samples]:
        """Yield the chunks; note what their lines set."""
        for chunk in chunks:
            for event in chunk.events:
                if isinstance(event, Mark):
                    self._read(event.index, event.text)
                elif isinstance(event, Dwell) and isinstance(event.action, Passthrough):
                    self._read(event.index, event.action.text)
            yield chunk

    def _read(self, index: int, text: bytes) -> None:
        latest = self._since[-1][1]
        if (changed := latest.after(text)) is not latest:
            self._since.append((index, changed))

    def _advanced(self, before: list[Samples], chunk: Samples, after: list[Samples]) -> Samples:
        around, start = [*before, chunk, *after], sum(map(len, before))
        K, half = self._in_force(chunk.first - start, sum(map(len, around)))
        own = slice(start, start + len(chunk))
        self.least = min(self.least, float(K[own].min()))
        self.most = max(self.most, float(K[own].max()))
        if not K.any():
            return chunk
        path, found = np.concatenate([each.xyze for each in around]), np.zeros((len(chunk), 2))
        found[:, 1] = K[own]
        for width in np.unique(half[own]).tolist():  # one, unless the file changes it here
            np.copyto(found[:, 0], self._ahead(path, K, width)[own], where=half[own] == width)
        return replace(chunk, advance=frozen(found), in_e=self._limits is not None)

    def _ahead(self, path: Array, K: Array, half: int) -> Array:
        if (limits := self._limits) is None:
            return smoothed(path, K, half)
        return bounded(path, K, limits.velocity, limits.acceleration, half)

    def _in_force(self, first: int, count: int) -> tuple[Array, Integers]:
        """Return K (count,) from a sample on, s, and over how many samples it is averaged."""
        K, half = np.empty(count), np.empty(count, np.int64)
        for index, advance in self._since:
            at = max(index - first, 0)
            K[at:], half[at:] = advance.seconds, _half(advance, self._limits)
        while len(self._since) > 1 and self._since[1][0] <= first:
            del self._since[0]
        return K, half


def _half(advance: Advance, limits: ExtruderLimits | None) -> int:
    """Return the samples over which advance is averaged before and after each.

    Klipper's weights are those of two means in turn, each over half of the time; ours are one.
    """
    share = 0.5 if limits is None else 0.25
    return max(round(share * advance.smooth_time / TS), 1)
