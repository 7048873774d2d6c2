"""The least squares of one stop. Symbols are those of ``model.stop_solver``.

p is (k, 2): the weights of k splines, in the order in which these begin, for x and y. In matrices
x and y alternate, so that a row in time has a prefix of columns only.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hframe_post.arrays import Array, Flags, Integers
from hframe_post.native import kernels

NEAREST = 24  # samples to either side in which the path's nearest point is sought, as in stop.c


@dataclass(frozen=True, slots=True)
class Splines:
    """The usable ones of all splines and the dwell.

    N (q, k): the command by p, from two samples before to two after; D (q − 2, k): its second
    differences; bands (q, 2): each row of N has nonzero values from one column to before another;
    by_p (2 or 3, r, k): outputs of the plant's filters by a half of p; first (k,): the row
    at which each spline begins to act; limit (q − 2,): bounds of the belts' second difference.
    """

    N: Array
    D: Array
    bands: Integers
    by_p: Array
    first: Integers
    limit: Array

    @classmethod
    def from_matrices(cls, N: Array, by_p: Array, limit: Array) -> Splines:
        N, by_p = np.ascontiguousarray(N), np.ascontiguousarray(by_p)
        first, last = (N != 0.0).argmax(axis=0), (N[::-1] != 0.0).argmax(axis=0)
        row = np.arange(len(N))
        over = np.searchsorted(np.sort(len(N) - last), row, side="right")
        begun = np.searchsorted(np.sort(first), row, side="right")
        bands = np.ascontiguousarray(np.column_stack([over, begun]))
        acts = (by_p != 0.0).any(axis=0).argmax(axis=0)
        first = np.minimum.accumulate(acts[::-1])[::-1].copy()
        return cls(N, np.diff(N, n=2, axis=0), bands, by_p, first, limit)


def solve_stop(
    path: Array, extruding: Flags, command: Array, rows: tuple[Integers, Array, slice],
    stop: Sequence[int], beside: int, shares: Array, soon: int, known: Array, levers: Array,
    splines: Splines, bounds: Array, origin: Array,
) -> None:  # fmt: skip
    """Write the command around a stop into the command (n, 2) of its stretch.

    path (n, 2), extruding (n,): of the stretch. rows: the r judged samples, counted from ``beside``
    before the stop, with their weights if all extrude, and which of them are in the dwell. stop: a,
    b, before, after, ends, see ``stop_cost.Stop``. shares (3,), soon: weights of samples in travel
    and in the dwell, and at its end if it extrudes within so many samples. known (r, 2): the nozzle
    without p; levers (0 or 1, r): of racking. bounds (11,): effort of x and y; from x, y to the
    belts, by rows; the least and then the greatest place on the bed, where the path's origin (2,)
    is; the belts' limit where nothing lowers it.
    """
    judged, weight, dwell = rows
    s = splines
    fits = kernels.solve_stop(
        path, extruding, len(path), command, judged, weight, len(judged), dwell.start, dwell.stop,
        np.array(stop), beside, shares, soon, known, levers, len(levers), s.by_p, s.first,
        len(s.first), s.N, s.D, s.bands, s.limit, len(s.N), bounds, origin,
    )  # fmt: skip
    assert fits
