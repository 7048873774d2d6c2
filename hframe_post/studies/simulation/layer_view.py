"""The path of a print with its predicted errors, layer by layer, small enough to look at.

Samples are merged into short segments, each with the largest error in it. If there are too many,
the whole view gets coarser by a step: neighbours of one feature in about the same direction are
joined. So the size of a view is bounded, and its shape is kept.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hframe_post.arrays import TS, Array, Integers, Z
from hframe_post.prediction.predict import Judgement
from hframe_post.prediction.statistics import Labels

FINEST = 1.0  # mm of a segment at most, as long as there are few; twice as much with each step
NEAR = 0.01  # mm that an end may be off the segment that it is joined into; likewise
SHAPED = 10  # steps that keep shape and feature; after them any neighbours are joined
MOST = 300_000  # segments of a print
COLUMNS = 6  # of a segment: the ones of ``Segments`` but errors


@dataclass(frozen=True, slots=True)
class Segments:
    """n ends of segments of one layer, in the order of time; each begins where the last ended.

    xy (n, 2): mm. line, feature (n,): source line, number of the feature. speed (n,): mm/s.
    begins (n,): the path before it is not known, so there is no segment. error (n, s): largest
    in the segment, mm, for each of s strategies.
    """

    xy: Array
    line: Integers
    feature: Integers
    speed: Array
    begins: Integers
    error: Array


class LayerView:
    """Collects the segments of each layer with the errors of the given strategies."""

    def __init__(self, strategies: tuple[str, ...]) -> None:
        self._strategies = strategies
        self._layers: dict[int, list[Array]] = {}
        self._count, self._apart = 0, True
        self.labels = Labels()
        self.coarser = 0  # by how many steps

    @property
    def finest(self) -> tuple[float, float]:
        """Return the longest segment, and how far positions may be off it, mm."""
        return FINEST * 2.0**self.coarser, NEAR * 2.0**self.coarser * (self.coarser > 0)

    def add(self, judgement: Judgement, layer: Integers, feature: Integers, labels: Labels) -> None:
        """Add judged samples; layer, feature: numbers in the labels, for the whole chunk."""
        self.labels = labels
        chunk, at = judgement.chunk, judgement.at
        if len(at):
            table = self._table(judgement, feature[at])
            for number in np.unique(layer[at]).tolist():
                rows = table[layer[at] == number]
                merged = self._simplified(_merged(rows, _starts(rows, self.finest[0])))
                self._layers.setdefault(number, []).append(merged)
                self._count += len(merged)
            self._apart = False
        self._apart = self._apart or chunk.ends_stretch
        while self._count > MOST:
            self._coarsen()

    def _table(self, judgement: Judgement, feature: Integers) -> Array:
        chunk, at = judgement.chunk, judgement.at
        xy = chunk.xyze[:, :Z]
        steps = np.hypot(*np.diff(xy, axis=0, prepend=xy[:1]).T)
        begins = np.zeros(len(at))
        begins[0] = self._apart
        errors = [judgement.contour[name] for name in self._strategies]
        return np.column_stack([xy[at], chunk.line[at], feature, steps[at] / TS, begins, *errors])

    def _coarsen(self) -> None:
        self.coarser += 1
        for number, tables in self._layers.items():
            self._layers[number] = [self._simplified(np.concatenate(tables))]
        self._count = sum(len(table) for (table,) in self._layers.values())

    def _simplified(self, rows: Array) -> Array:
        """Join neighbours, pair by pair, as far as the present step allows."""
        if self.coarser > SHAPED:
            return _merged(rows, np.arange(0, len(rows), 2))
        for _ in range(self.coarser + 1):
            pairs = _pairs(rows, *self.finest) if self.coarser else np.arange(0)
            if not len(pairs):
                break
            rows = _merged(rows, np.delete(np.arange(len(rows)), pairs))
        return rows

    def layers(self) -> dict[int, Segments]:
        """Return the segments by layer number, in order."""
        found = {}
        for number in sorted(self._layers):
            rows = np.concatenate(self._layers[number])
            line, feature, begins = (rows[:, k].astype(np.int64) for k in (2, 3, 5))
            found[number] = Segments(
                rows[:, :2], line, feature, rows[:, 4], begins, rows[:, COLUMNS:]
            )
        return found


def _starts(rows: Array, length: float) -> Integers:
    """Return the rows at which a segment begins: another line or feature, or far from the last."""
    way = np.cumsum(np.hypot(*np.diff(rows[:, :2], axis=0, prepend=rows[:1, :2]).T))
    new = np.diff(rows[:, 2], prepend=-1.0) != 0.0
    new |= np.diff(rows[:, 3], prepend=-1.0) != 0.0
    new |= np.diff(np.floor(way / length), prepend=-1.0) != 0.0
    return np.flatnonzero(new)


def _pairs(rows: Array, length: float, near: float) -> Integers:
    """Return rows that may be joined to the one before: same feature, about the same direction."""
    ends, begins = rows[:, :2], rows[:, 5] != 0.0
    step, turn = np.diff(ends, axis=0), np.zeros(len(rows))  # turn: k off the chord
    chord = np.hypot(*(ends[2:] - ends[:-2]).T)
    area = np.abs(step[:-1, 0] * step[1:, 1] - step[:-1, 1] * step[1:, 0])
    onward = (step[:-1] * step[1:]).sum(axis=1) >= 0.0
    turn[1:-1] = np.where(onward, area / np.maximum(chord, 1e-9), np.inf)
    joinable = np.zeros(len(rows), dtype=bool)
    joinable[2:] = (
        (turn[1:-1] <= near) & (chord <= length) & (rows[2:, 3] == rows[1:-1, 3])
        & ~begins[2:] & ~begins[1:-1]
    )  # fmt: skip
    k = np.arange(len(rows))
    first = np.maximum.accumulate(np.where(joinable, 0, k))  # the last row that may not
    return np.flatnonzero(joinable & ((k - first) % 2 == 1))  # disjoint pairs


def _merged(rows: Array, starts: Integers) -> Array:
    """Merge the rows from each start to the next: the last position, the largest error."""
    last = np.append(starts[1:], len(rows)) - 1
    merged = rows[last]
    merged[:, 4:] = np.maximum.reduceat(rows[:, 4:], starts, axis=0)
    return np.asarray(merged)
