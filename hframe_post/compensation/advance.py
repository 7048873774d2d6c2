"""How far the extruder is ahead of the path: pressure advance, as the firmware or we make it.

The nozzle is on the path at the path's own time, whatever the command does. So advance follows from
the path, and is the same for all strategies.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from hframe_post.arrays import TS, Array, E, Integers
from hframe_post.firmware.dialect import Advance, ExtruderLimits
from hframe_post.model.pressure_advance import NEAR, REACH, bounded, extruding, smoothed
from hframe_post.printer.settings import MAX_SMOOTHING_S
from hframe_post.stream.chunks import neighbours, stretches
from hframe_post.stream.marks import SETS
from hframe_post.stream.tally import joined, tallied
from hframe_post.stream.types import Samples, frozen, said

AROUND = REACH + NEAR + round(MAX_SMOOTHING_S / TS / 2.0)  # samples on which advance depends
APART = 2 * NEAR  # samples between two speeds of the extruder, for its acceleration


@dataclass(frozen=True, slots=True)
class AdvanceSummary:
    """Advance wherever there are samples: least and most of it, s.

    hardest: greatest acceleration, mm/s², of an extruder to which the firmware adds the advance.
    """

    least: float = tallied(math.inf, min)
    most: float = tallied(0.0, max)
    hardest: float = tallied(0.0, max)


class Advancing:
    """Adds advance to samples, and sums it up in ``summary``.

    advance: in force before the first. limits: of an extruder whose E must contain its
    advance; None: the firmware adds its own, and this is what it does.
    """

    def __init__(self, advance: Advance, limits: ExtruderLimits | None) -> None:
        self._limits = limits
        self._since = [(0, advance)]  # in force from these samples on, as far as they are needed
        self.summary = AdvanceSummary()

    def samples(self, chunks: Iterable[Samples]) -> Iterator[Samples]:
        """Yield the chunks with their advance."""
        for stretch in stretches(self._noted(chunks)):
            for before, chunk, after in neighbours(stretch, AROUND, AROUND):
                yield self._advanced(before, chunk, after) if len(chunk) else chunk

    def _noted(self, chunks: Iterable[Samples]) -> Iterator[Samples]:
        """Yield the chunks; note what their lines set."""
        for chunk in chunks:
            for event in chunk.events:
                for mark in said(event, SETS):
                    latest = self._since[-1][1]
                    if (changed := latest.after(mark.text)) is latest:
                        continue
                    if self._since[-1][0] == mark.index:  # the last of several holds
                        self._since.pop()
                    self._since.append((mark.index, changed))
            yield chunk

    def _advanced(self, before: list[Samples], chunk: Samples, after: list[Samples]) -> Samples:
        if len(self._since) == 1 and not self._since[0][1].seconds:  # as in most files
            self._note(0.0, 0.0)
            return chunk
        around, start = [*before, chunk, *after], sum(map(len, before))
        K, half = self._in_force(chunk.first - start, sum(map(len, around)))
        own = slice(start, start + len(chunk))
        self._note(float(K[own].min()), float(K[own].max()))
        if not K.any():
            return chunk
        path, found = np.concatenate([each.xyze for each in around]), np.zeros((len(chunk), 2))
        found[:, 1] = K[own]
        for width in np.unique(half[own]).tolist():  # one, unless the file changes it here
            ahead = self._ahead(path, K, width)
            np.copyto(found[:, 0], ahead[own], where=half[own] == width)
            if self._limits is None:
                near = slice(max(own.start - APART, 0), own.stop)
                self._note(hardest=_hardest(path[near], ahead[near]))
        return replace(chunk, advance=frozen(found), in_e=self._limits is not None)

    def _note(self, least: float = math.inf, most: float = 0.0, hardest: float = 0.0) -> None:
        self.summary = joined(self.summary, AdvanceSummary(least, most, hardest))

    def _ahead(self, path: Array, K: Array, half: int) -> Array:
        if (limits := self._limits) is None:
            return smoothed(path, K, half)
        return bounded(path, K, limits.velocity, limits.acceleration, half)

    def _in_force(self, first: int, count: int) -> tuple[Array, Integers]:
        """Return K (count,) from a sample on, s, and over how many samples it is averaged."""
        computed = self._limits is not None
        since, known = zip(*self._since, strict=True)
        begun = np.clip(np.array(since) - first, 0, count)
        begun[0], counts = 0, np.empty(len(begun), np.int64)
        counts[:-1], counts[-1] = begun[1:] - begun[:-1], count - begun[-1]
        K = np.repeat([each.seconds for each in known], counts)
        half = np.repeat([each.half(computed) for each in known], counts)
        del self._since[: max(bisect_right(since, first) - 1, 0)]
        return K, half


def _hardest(path: Array, ahead: Array) -> float:
    """Return the greatest acceleration, mm/s², of the extruder in lines, retractions left out."""
    fed = np.where(extruding(path), np.diff(path[:, E]), 0.0)
    speed = (fed + np.diff(ahead)) / TS
    return float(np.abs(speed[APART:] - speed[:-APART]).max(initial=0.0) / (APART * TS))
