"""The path of a print and the nozzle's path, small enough to look at.

Between two judged samples is a piece, with its error and where the nozzle is at its end. Pieces
that continue straight on are joined, with the largest error in them. If there are too many, the
whole picture gets coarser by a step. So its size is bounded, and its shape is kept.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hframe_post.arrays import Array, Integers, Z
from hframe_post.native.judging import Table, draw_pieces, join_pieces
from hframe_post.prediction.predict import Judgement
from hframe_post.prediction.statistics import TRAVEL, Labels

FINEST = 2.0  # mm of a piece at most, as long as there are few; twice as much with each step
NEAR = 0.01  # mm that the path may be off the line drawn for it; likewise
FINER = 2.5  # times as exact is the way from the path to the nozzle, which is drawn magnified
SHAPED = 11  # steps that keep shape and feature; after them any neighbours are joined
MOST = 150_000  # pieces of a print: with twice as many, a page takes 30 MB more memory
MERGED = 8  # tables that become one with each step
# Columns of a table, after x and y, of numbers that are the bits of an int32. Behind them are
# ``off`` of all strategies, the speed, nozzle of all, error of all: see ``Pieces``
LINE, LAYER, FEATURE, BEGINS, WAYS = range(Z, Z + 5)


@dataclass(frozen=True, slots=True)
class Pieces:
    """n ends of pieces, layer by layer in the order of time; each begins where the last ended.

    xy (n, 2): mm. line, layer, feature (n,): source line, numbers of layer and feature. begins
    (n,): whether the path before it is unknown, so that it is not a piece. speed (n,): mm/s.

    For each of s strategies, in mm: nozzle (n, s, 2), where it is at the same time, from xy; off
    (n, s, 2): the way to it from the nearest place on the path; error (n, s): the largest distance
    in the piece.
    """

    xy: Table
    line: Integers
    layer: Integers
    feature: Integers
    begins: Integers
    speed: Table
    nozzle: Table
    off: Table
    error: Table


class Picture:
    """Collects pieces with the errors of each strategy, and sums by layer and feature.

    strategies: those of the judgements. labels: name the layers and features. sums: (layer,
    feature) → number of samples in motion, and the sum of squared errors (mm²) of each strategy.
    """

    def __init__(self, labels: Labels) -> None:
        self.strategies: tuple[str, ...] = ()
        self.labels = labels
        self.sums: dict[tuple[int, int], Array] = {}
        self.coarser = 0  # by how many steps
        self._tables: list[Table] = []
        self._count, self._apart = 0, True

    @property
    def finest(self) -> tuple[float, float]:
        """Return the longest piece, and how far positions may be off it, mm."""
        return FINEST * 2.0**self.coarser, NEAR * 2.0**self.coarser

    def add(self, judgement: Judgement) -> None:
        window, chunk = judgement.window, judgement.chunk
        starts, numbers = self.labels.runs(chunk)
        if count := len(judgement.at):
            self.strategies = judgement.strategies
            table = np.empty((count, self._columns), np.float32)
            sums = np.zeros((len(starts), 2, 1 + len(self.strategies)))
            count = draw_pieces(
                window.piece.xyze, window.piece.line, judgement.at, window.start,
                judgement.extruding, starts, numbers, self._apart, judgement.nozzle,
                judgement.begin, judgement.apart, judgement.off, judgement.errors, *self._rules,
                sums, table,
            )  # fmt: skip
            self._append(table[:count].copy(), self.coarser)
            self._apart = False
            travel = self.labels.features.index(TRAVEL)
            for (layer, feature), printed, moved in zip(
                numbers.tolist(), *judgement.every * sums.transpose(1, 0, 2), strict=True
            ):
                self._sum(layer, feature, printed)
                self._sum(layer, travel, moved)
        self._apart = self._apart or chunk.ends_stretch

    def join(self, later: Picture) -> None:
        """Add the picture of what follows."""
        self.strategies = self.strategies or later.strategies
        layers = np.array([self.labels.layer(name) for name in later.labels.layers])
        features = np.array([self.labels.feature(name) for name in later.labels.features])
        for (layer, feature), sums in later.sums.items():
            self._sum(int(layers[layer]), int(features[feature]), sums)
        while self.coarser < later.coarser:
            self._coarsen()
        for table in later._tables:
            numbers = _numbers(table)
            numbers[:, LAYER] = layers.take(numbers[:, LAYER])
            numbers[:, FEATURE] = features.take(numbers[:, FEATURE])
            self._append(table, later.coarser)

    def pieces(self) -> Pieces:
        count, speed = len(self.strategies), WAYS + 2 * len(self.strategies)
        table = np.concatenate(self._tables or [np.zeros((0, self._columns), np.float32)])
        self._tables = [table]  # else there would be two of all pieces
        if (np.diff(_numbers(table)[:, LAYER]) < 0).any():  # objects are printed one at a time
            table = table[np.argsort(_numbers(table)[:, LAYER], kind="stable")]
        _, _, line, layer, feature, begins = _numbers(table)[:, :WAYS].T.astype(np.int64)
        off, nozzle = (
            table[:, first : first + 2 * count].reshape(-1, count, 2) for first in (WAYS, speed + 1)
        )
        error = table[:, self._columns - count :]
        return Pieces(
            table[:, :Z], line, layer, feature, begins, table[:, speed], nozzle, off, error
        )

    @property
    def _columns(self) -> int:
        """Return how many numbers a piece has; see ``Pieces``."""
        return WAYS + 1 + 5 * len(self.strategies)

    @property
    def _rules(self) -> tuple[int, float, float, float]:
        """Return which pieces are joined at the present step; see ``join_pieces``."""
        length, near = self.finest
        alike = WAYS if self.coarser > SHAPED else LAYER if self.coarser else LINE
        return alike, length, near, near / FINER

    def _sum(self, layer: int, feature: int, sums: Array) -> None:
        if sums[0]:
            self.sums[layer, feature] = self.sums.get((layer, feature), 0.0) + sums

    def _append(self, table: Table, coarser: int) -> None:
        """Add a table, which is already as coarse as after some steps."""
        self._tables.append(self._simplified(table) if coarser < self.coarser else table)
        self._count += len(self._tables[-1])
        while self._count > MOST:
            self._coarsen()

    def _coarsen(self) -> None:
        self.coarser += 1
        finer, self._tables = self._tables, []
        while finer:  # each is freed as soon as its coarser one is made
            self._tables.append(self._simplified(np.concatenate(finer[:MERGED])))
            del finer[:MERGED]
        self._count = sum(map(len, self._tables))

    def _simplified(self, table: Table) -> Table:
        """Join neighbours: the last position, the largest error."""
        return table[: join_pieces(table, len(self.strategies), *self._rules)].copy()


def _numbers(table: Table) -> NDArray[np.int32]:
    """Return a table's columns LINE, LAYER, FEATURE and BEGINS as numbers."""
    return table.view(np.int32)
