"""The path of a print and the nozzle's path, small enough to look at.

Between two judged samples is a piece, with its error and where the nozzle is at its end. Pieces
that continue straight on are joined, with the largest error in them. If there are too many, the
whole picture gets coarser by a step. So its size is bounded, and its shape is kept.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hframe_post.arrays import TS, Array, Integers, Z
from hframe_post.native.judging import Table, joined_pieces
from hframe_post.prediction.predict import Judgement
from hframe_post.prediction.statistics import Labels

FINEST = 2.0  # mm of a piece at most, as long as there are few; twice as much with each step
NEAR = 0.01  # mm that the path may be off the line drawn for it; likewise
FINER = 2.5  # times as exact is the way from the path to the nozzle, which is drawn magnified
SHAPED = 11  # steps that keep shape and feature; after them any neighbours are joined
MOST = 150_000  # pieces of a print: with twice as many, a page takes 30 MB more memory
MERGED = 8  # tables that become one with each step
# Rows of a table, after x and y. Numbers of lines, layers and features are the bits of int32 in it
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
        chunk, at = judgement.chunk, judgement.at
        layer, feature = (numbers.take(at) for numbers in self.labels.number(chunk))
        if len(at):
            self.strategies = judgement.strategies
            errors = judgement.errors.T
            self._sum(layer, feature, errors, judgement.every)
            line = chunk.line.take(at)
            shape = np.empty((self._speed, len(at)), np.float32)
            shape[:Z] = _columns(chunk.xyze, at)[:Z]
            _numbers(shape)[:-1] = line, layer, feature
            _numbers(shape)[-1] = 0
            _numbers(shape)[-1, 0] = self._apart
            shape[WAYS:] = judgement.off.reshape(len(at), -1).T
            kept = self._kept(shape)
            end = at.take(kept)
            place = _columns(chunk.xyze, end)[:Z]
            self._append(np.vstack([
                shape.take(kept, axis=1),
                np.hypot(*(place - _columns(chunk.xyze, end - 1)[:Z]))[None] / TS,
                *(
                    nozzle.take((end - judgement.begin) // judgement.apart, axis=0).T - place
                    for nozzle in judgement.nozzle
                ),
                np.maximum.reduceat(errors, _begun(kept), axis=1),
            ], dtype=np.float32, casting="same_kind"), self.coarser)  # fmt: skip
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
            _, layer, feature, _ = _numbers(table)
            layer[:], feature[:] = layers.take(layer), features.take(feature)
            self._append(table, later.coarser)

    def pieces(self) -> Pieces:
        count, speed = len(self.strategies), self._speed
        table = np.hstack(self._tables or [np.zeros((speed + 1, 0), np.float32)])
        self._tables = [table]  # else there would be two of all pieces
        if (np.diff(_numbers(table)[LAYER - LINE]) < 0).any():  # objects are printed one at a time
            table = table[:, np.argsort(_numbers(table)[LAYER - LINE], kind="stable")]
        line, layer, feature, begins = _numbers(table).astype(np.int64)
        off, nozzle = (
            rows.reshape(count, 2, -1).transpose(2, 0, 1) if count else rows.reshape(0, 0, 2)
            for rows in (table[WAYS:speed], table[speed + 1 : self._errors])
        )
        error = table[self._errors :].T
        return Pieces(table[:Z].T, line, layer, feature, begins, table[speed], nozzle, off, error)

    @property
    def _speed(self) -> int:
        """Return the row of the speed; the rows above it decide what is joined."""
        return WAYS + 2 * len(self.strategies)

    @property
    def _errors(self) -> int:
        """Return the first row of the largest errors, which follow speed and nozzle."""
        return self._speed + 1 + 2 * len(self.strategies)

    def _sum(self, layer: Integers, feature: Integers, errors: Array, every: int) -> None:
        starts = _starts(layer, feature)
        counts, squares = np.diff(starts, append=len(layer)), np.square(errors)
        sums = every * np.vstack([counts, np.add.reduceat(squares, starts, axis=1)])
        keys = zip(layer[starts].tolist(), feature[starts].tolist(), strict=True)
        for key, here in zip(keys, sums.T, strict=True):
            self.sums[key] = self.sums.get(key, 0.0) + here

    def _append(self, table: Table, coarser: int) -> None:
        """Add a table, which is already as coarse as after some steps."""
        self._tables.append(self._simplified(table) if coarser < self.coarser else table)
        self._count += self._tables[-1].shape[1]
        while self._count > MOST:
            self._coarsen()

    def _coarsen(self) -> None:
        self.coarser += 1
        finer, self._tables = self._tables, []
        while finer:  # each is freed as soon as its coarser one is made
            self._tables.append(self._simplified(np.hstack(finer[:MERGED])))
            del finer[:MERGED]
        self._count = sum(table.shape[1] for table in self._tables)

    def _simplified(self, table: Table) -> Table:
        """Join neighbours: the last position, the largest error."""
        kept = self._kept(table[: self._speed])
        joined = table.take(kept, axis=1)
        joined[self._errors :] = np.maximum.reduceat(table[self._errors :], _begun(kept), axis=1)
        return joined

    def _kept(self, shape: Table) -> Integers:
        """Return where pieces end after joining, pair by pair, as far as the present step allows.

        shape: rows of a table above the speed.
        """
        n = shape.shape[1]
        if self.coarser > SHAPED:
            return np.append(np.arange(1, n - 1, 2), n - 1)
        length, near = self.finest
        alike = LAYER if self.coarser else LINE
        return joined_pieces(shape, alike, WAYS, length, near, near / FINER)


def _numbers(table: Table) -> NDArray[np.int32]:
    """Return the rows LINE, LAYER, FEATURE and BEGINS of a table, which can be written to."""
    numbers: NDArray[np.int32] = table.view(np.int32)[LINE:WAYS]
    return numbers


def _columns(rows: Array, chosen: Integers) -> Array:
    """Return the columns of the chosen rows."""
    return rows.take(chosen, axis=0).T  # a sixth of the time of rows[chosen]


def _begun(kept: Integers) -> Integers:
    """Return where pieces begin that end at ``kept``."""
    return np.append(0, kept[:-1] + 1)


def _starts(*rows: Integers) -> Integers:
    """Return the columns at which any row differs from the column before."""
    new = np.ones(len(rows[0]), dtype=bool)
    new[1:] = rows[0][1:] != rows[0][:-1]
    for row in rows[1:]:
        new[1:] |= row[1:] != row[:-1]
    return np.flatnonzero(new)
