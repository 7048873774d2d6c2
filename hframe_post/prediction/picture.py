"""The path of a print and the nozzle's path, small enough to look at.

Judged samples are merged into pieces of some milliseconds, each with the largest error in it and
where the nozzle is at its end. Pieces that continue straight on are joined. If there are too many,
the whole picture gets coarser by a step. So its size is bounded, and its shape is kept.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hframe_post.arrays import TS, Array, Integers, Z
from hframe_post.prediction.predict import Judgement
from hframe_post.prediction.statistics import Labels

PIECE = 4  # samples of a piece at first; ringing at 50 Hz takes 20
FINEST = 2.0  # mm of a piece at most, as long as there are few; twice as much with each step
NEAR = 0.01  # mm that the path may be off the line drawn for it; likewise
FINER = 2.5  # times as exact is the way from the path to the nozzle, which is drawn magnified
PASSES = 4  # of joining pairs, as long as they join an eighth
SHAPED = 11  # steps that keep shape and feature; after them any neighbours are joined
MOST = 300_000  # pieces of a print
LINE, LAYER, FEATURE, BEGINS, SPEED, LINES = range(Z, Z + 6)  # rows of a table, after x and y


@dataclass(frozen=True, slots=True)
class Pieces:
    """n ends of pieces, layer by layer in the order of time; each begins where the last ended.

    xy (n, 2): mm. line, layer, feature (n,): source line, numbers of layer and feature. begins
    (n,): whether the path before it is unknown, so that there is no piece. speed (n,): mm/s.

    For each of s strategies, in mm: nozzle (n, s, 2), where it is at the same time, from xy; off
    (n, s, 2): the way to it from the nearest place on the path; error (n, s): the largest distance
    in the piece.
    """

    xy: Array
    line: Integers
    layer: Integers
    feature: Integers
    begins: Integers
    speed: Array
    nozzle: Array
    off: Array
    error: Array


class Picture:
    """Collects pieces with the errors of each strategy, and sums by layer and feature.

    strategies: those of the judgements. labels: name the layers and features. sums: (layer,
    feature) → number of samples, and the sum of squared errors (mm²) of each strategy.
    """

    def __init__(self, labels: Labels) -> None:
        self.strategies: tuple[str, ...] = ()
        self.labels = labels
        self.sums: dict[tuple[int, int], Array] = {}
        self.coarser = 0  # by how many steps
        self._tables: list[Array] = []
        self._count, self._apart = 0, True

    @property
    def finest(self) -> tuple[float, float]:
        """Return the longest piece, and how far positions may be off it, mm."""
        return FINEST * 2.0**self.coarser, NEAR * 2.0**self.coarser

    def add(self, judgement: Judgement) -> None:
        chunk, at = judgement.chunk, judgement.at
        layer, feature = (numbers[at] for numbers in self.labels.number(chunk))
        if len(at):
            self.strategies = tuple(judgement.contour)
            errors = np.stack(list(judgement.contour.values()))
            self._sum(layer, feature, errors)
            starts = _starts((chunk.first + at) // PIECE, chunk.line[at], layer, feature)
            last = np.append(starts[1:], len(at)) - 1
            end = at[last]
            x, y = chunk.xyze[:, :Z].T
            speed = np.hypot(x[end] - x[end - 1], y[end] - y[end - 1]) / TS
            place, begins = chunk.xyze[end, :Z], np.zeros(len(end))
            begins[0] = self._apart
            self._append(np.vstack([
                x[end], y[end], chunk.line[end], layer[last], feature[last], begins, speed,
                *((judgement.motion[name][end] - place).T for name in self.strategies),
                *(judgement.off[name][last].T for name in self.strategies),
                np.maximum.reduceat(errors, starts, axis=1),
            ]))  # fmt: skip
            self._apart = False
        self._apart = self._apart or chunk.ends_stretch

    def join(self, later: Picture) -> None:
        """Add the picture of what follows."""
        self.strategies = self.strategies or later.strategies
        layers = np.array([self.labels.layer(name) for name in later.labels.layers])
        features = np.array([self.labels.feature(name) for name in later.labels.features])
        for (layer, feature), sums in later.sums.items():
            key = int(layers[layer]), int(features[feature])
            self.sums[key] = self.sums.get(key, 0.0) + sums
        while self.coarser < later.coarser:
            self._coarsen()
        for table in later._tables:
            table[LAYER] = layers[table[LAYER].astype(np.int64)]
            table[FEATURE] = features[table[FEATURE].astype(np.int64)]
            self._append(table, later.coarser)

    def pieces(self) -> Pieces:
        count = len(self.strategies)
        table = np.hstack(self._tables) if self._tables else np.zeros((LINES, 0))
        if (np.diff(table[LAYER]) < 0.0).any():  # objects are printed one at a time
            table = table[:, np.argsort(table[LAYER], kind="stable")]
        line, layer, feature, begins = table[LINE:SPEED].astype(np.int64)
        lines = table[LINES : self._errors].reshape(2, count, 2, table.shape[1])
        nozzle, off = lines.transpose(0, 3, 1, 2)
        return Pieces(
            table[:Z].T, line, layer, feature, begins, table[SPEED], nozzle, off,
            table[self._errors :].T,
        )  # fmt: skip

    @property
    def _errors(self) -> int:
        """Return the first row of the largest errors, which follow nozzle and off."""
        return LINES + 4 * len(self.strategies)

    def _sum(self, layer: Integers, feature: Integers, errors: Array) -> None:
        starts = _starts(layer, feature)
        sums = np.add.reduceat(np.vstack([np.ones(len(layer)), np.square(errors)]), starts, axis=1)
        keys = zip(layer[starts].tolist(), feature[starts].tolist(), strict=True)
        for key, here in zip(keys, sums.T, strict=True):
            self.sums[key] = self.sums.get(key, 0.0) + here

    def _append(self, table: Array, coarser: int = -1) -> None:
        """Add a table, which is already as coarse as after some steps."""
        self._tables.append(self._simplified(table) if coarser < self.coarser else table)
        self._count += self._tables[-1].shape[1]
        while self._count > MOST:
            self._coarsen()

    def _coarsen(self) -> None:
        self.coarser += 1
        if self._tables:
            self._tables = [self._simplified(np.hstack(self._tables))]
            self._count = self._tables[0].shape[1]

    def _simplified(self, table: Array) -> Array:
        """Join neighbours, pair by pair, as far as the present step allows."""
        if self.coarser > SHAPED:
            return self._joined(table, np.arange(0, table.shape[1], 2))
        for _ in range(PASSES):
            pairs = self._pairs(table)
            if len(pairs):
                table = self._joined(table, np.delete(np.arange(table.shape[1]), pairs))
            if 8 * len(pairs) < table.shape[1]:
                break
        return table

    def _joined(self, table: Array, starts: Integers) -> Array:
        """Join the columns from each start to the next: the last position, the largest error."""
        joined = table[:, np.append(starts[1:], table.shape[1]) - 1]
        joined[self._errors :] = np.maximum.reduceat(table[self._errors :], starts, axis=1)
        return np.asarray(joined)

    def _pairs(self, table: Array) -> Integers:
        """Return columns that may be joined to the one before: alike, and both lines straight."""
        n, (length, near) = table.shape[1], self.finest
        if n < 3:
            return np.arange(0)
        x, y = table[:Z]
        dx, dy = x[2:] - x[:-2], y[2:] - y[:-2]
        square = dx * dx + dy * dy
        share = (x[1:-1] - x[:-2]) * dx + (y[1:-1] - y[:-2]) * dy
        share /= np.maximum(square, 1e-12)
        straight = (square <= length * length) & (share >= 0.0) & (share <= 1.0)
        ways = table[LINES + 2 * len(self.strategies) : self._errors]
        for rows, most in ((table[:Z], near), (ways, near / FINER)):
            for row in rows:
                straight &= np.abs(row[1:-1] - row[:-2] - share * (row[2:] - row[:-2])) <= most
        for row in table[LAYER if self.coarser else LINE : BEGINS]:
            straight &= row[2:] == row[1:-1]
        begins = table[BEGINS] != 0.0
        joinable = np.zeros(n, dtype=bool)
        joinable[2:] = straight & ~begins[2:] & ~begins[1:-1]
        k = np.arange(n)
        first = np.maximum.accumulate(np.where(joinable, 0, k))  # the last one that may not
        return np.flatnonzero(joinable & ((k - first) % 2 == 1))  # disjoint pairs


def _starts(*rows: Integers) -> Integers:
    """Return the columns at which any row differs from the column before."""
    new = np.ones(len(rows[0]), dtype=bool)
    new[1:] = rows[0][1:] != rows[0][:-1]
    for row in rows[1:]:
        new[1:] |= row[1:] != row[:-1]
    return np.flatnonzero(new)
