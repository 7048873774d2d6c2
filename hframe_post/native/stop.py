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

NEAREST = 24  # samples to either side in which the path's nearest point is sought; C takes no other
ALONG = 0.01  # times the weight of a squared deviation across the path, for that along it
FAR = 0.05  # mm off the path beyond which an extruding sample gets more weight
SEARCHES, EMPHASES, TRIALS = 2, 3, 10  # iterations of steps 1, 3 and 2
HARD_TRIALS = 100  # more of step 2 while a belt exceeds HARDEST: rows times shares, as Lawson does
HARD_TARGET = 0.95  # share of HARDEST above which a row is raised then
EMPHASIS, MOST_EMPHASIS = 1.5, 10.0  # factors of weights where the nozzle is FAR
TARGET = 0.7  # share of its bound from which on a row of E is raised, so that it stays below
EASY = 0.4  # share of its bound below which a row of E is lowered again
RAISED, MOST_RAISED = 2.0, 5.0  # factors of E²
HARDEST = 0.97 / 0.8  # times its bound, an acceleration that is exceeded only if it must be
EXCESS_COST = 0.2  # mm² for exceeding a bound by as much again, next to the squared deviations
HARD_COST = 100.0  # mm² for exceeding HARDEST by as much again at one sample
SHORT2 = 1e-14  # mm², squared length up to which a vector has no direction
ROOM = 45_000  # numbers that the compiled loop needs to work in; C takes no fewer
CLEARANCE = 0.02  # mm to the bed's edge for a command that would leave it
RULES = np.array([
    ALONG, FAR, EMPHASIS, MOST_EMPHASIS, TARGET, EASY, RAISED, MOST_RAISED, HARDEST,
    EXCESS_COST, HARD_TARGET, HARD_COST, SHORT2, CLEARANCE,
])  # fmt: skip
AT_MOST = np.array([SEARCHES, EMPHASES, TRIALS, HARD_TRIALS])


@dataclass(frozen=True, slots=True)
class Splines:
    """The usable ones of all splines and the dwell.

    N (q, k): the command by p, from two samples before to two after; D (q − 2, k): its second
    differences; bands (q, 2): each row of N has nonzero values from one column to before another;
    by_p (2 + couplings, r, k): outputs of the plant's filters by a half of p; first (k,): the row
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
    axes: Integers, splines: Splines, bounds: Array, origin: Array,
) -> None:  # fmt: skip
    """Write the command around a stop into the command (n, 2) of its stretch.

    path (n, 2), extruding (n,): of the stretch. rows: the r judged samples, counted from ``beside``
    before the stop, with their weights if all extrude, and which of them are in the dwell. stop: a,
    b, before, after, ends, see ``stop_cost.Stop``. shares (3,), soon: weights of samples in travel
    and in the dwell, and at its end if it extrudes within so many samples. known (r, 2): the nozzle
    without p; levers (couplings, r); axes (couplings, 2): where these respond, and their command.
    bounds (11,): effort of x and y; from x, y to the belts, by rows; the least and then the
    greatest place on the bed, where the path's origin (2,) is; the belts' limit where nothing
    lowers it.
    """
    judged, weight, dwell = rows
    s = splines
    fits = kernels.solve_stop(
        path, extruding, len(path), command, judged, weight, len(judged), dwell.start, dwell.stop,
        np.array(stop), beside, shares, soon, known, levers, axes, len(axes), s.by_p, s.first,
        len(s.first), s.N, s.D, s.bands, s.limit, len(s.N), bounds, origin, AT_MOST, RULES, NEAREST,
        np.empty(ROOM),
    )  # fmt: skip
    assert fits
