"""How far the extruder is ahead of the path: pressure advance, as the firmware or we make it.

The nozzle is on the path at the path's own time, whatever the command does. So advance follows from
the path, and is the same for all strategies.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np

from hframe_post.arrays import TS, Array
from hframe_post.firmware.advance import Advance, ExtruderLimits
from hframe_post.model.advance import NEAR, REACH, bounded, smoothed
from hframe_post.stream.chunks import neighbours, stretches
from hframe_post.stream.types import Dwell, Mark, Passthrough, Samples, frozen


class Advancing:
    """Adds advance to samples. ``least``, ``most``: s of it, wherever there are samples.

    advance: in force before the first. limits: of an extruder that must be told; None: the
    firmware adds its own advance, and what is added here is what it does.
    """

    def __init__(self, advance: Advance, limits: ExtruderLimits | None) -> None:
        self._advance, self._limits = advance, limits
        self._since = [(0, advance)]  # in force from these samples on, as far as they are needed
        self.least, self.most = math.inf, 0.0

    def samples(self, chunks: Iterable[Samples]) -> Iterator[Samples]:
        """Yield the chunks with their advance."""
        for stretch in stretches(self._noted(chunks)):
            for before, chunk, after in neighbours(stretch, self._reach, self._reach):
                yield self._advanced(before, chunk, after) if len(chunk) else chunk

    @property
    def _reach(self) -> int:
        return REACH + NEAR + _half(self._advance, self._limits)

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
            # the rule, and so its smoothing time, is that of the beginning
            self._since.append((index, replace(changed, smooth_time=latest.smooth_time)))

    def _advanced(self, before: list[Samples], chunk: Samples, after: list[Samples]) -> Samples:
        around = [*before, chunk, *after]
        first, start = chunk.first - sum(map(len, before)), sum(map(len, before))
        K = self._seconds(first, sum(map(len, around)))
        own = K[start : start + len(chunk)]
        self.least, self.most = min(self.least, float(own.min())), max(self.most, float(own.max()))
        if not K.any():
            return chunk
        path = np.concatenate([each.xyze for each in around])
        half, limits = _half(self._advance, self._limits), self._limits
        if limits is None:
            found = smoothed(path, K, half)
        else:
            found = bounded(path, K, limits.velocity, limits.acceleration, half)
        ahead = found[start : start + len(chunk)]
        table = frozen(np.column_stack([ahead, own]))
        return replace(chunk, advance=table, in_e=limits is not None)

    def _seconds(self, first: int, count: int) -> Array:
        """Return K (count,) from a sample on, s."""
        K = np.empty(count)
        for index, advance in self._since:
            K[max(index - first, 0) :] = advance.seconds
        while len(self._since) > 1 and self._since[1][0] <= first:
            del self._since[0]
        return K


def _half(advance: Advance, limits: ExtruderLimits | None) -> int:
    """Return the samples over which advance is averaged before and after each.

    Klipper's weights are those of two means in turn, each over half of the time; ours are one.
    """
    share = 0.5 if limits is None else 0.25
    return max(round(share * advance.smooth_time / TS), 1)
