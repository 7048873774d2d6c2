"""The least squares of one stop. Symbols are those of ``model.stop_solver``.

p is (k, 2): the weights of k splines, in the order in which these begin, for x and y. In matrices
x and y alternate, so that a row in time has a prefix of columns only.
"""

from __future__ import annotations

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
BED = slice(6, 10)  # of a problem's bounds: the bed's edges
CLEARANCE = 0.02  # mm to the bed's edge for a command that would leave it
RULES = np.array([
    ALONG, FAR, EMPHASIS, MOST_EMPHASIS, TARGET, EASY, RAISED, MOST_RAISED, HARDEST,
    EXCESS_COST, HARD_TARGET, HARD_COST, SHORT2, CLEARANCE,
])  # fmt: skip


@dataclass(frozen=True, slots=True)
class Splines:
    """The usable ones of all splines and the dwell.

    N (q, k): the command by p, from two samples before to two after; by_column (k, q): the same;
    D (q − 2, k): its second differences; bands (q, 2): each row of N has nonzero values from one
    column to before another; by_p (2 + couplings, r, k): outputs of the plant's filters by a half
    of p; first (k,): the row at which each spline begins to act; limit (q − 2,): bounds of the
    belts' second difference.
    """

    N: Array
    by_column: Array
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
        by_column = np.ascontiguousarray(N.T)
        return cls(N, by_column, np.diff(N, n=2, axis=0), bands, by_p, first, limit)


@dataclass(frozen=True, slots=True)
class Problem:
    """A stop's least squares at r judged samples, the rows.

    path (n, 2): of a stretch; index (r,): the rows' places in it; dwell: those in the dwell, where
    the path is at rest; weight (r,); extruding (r,): which count as printed. known (r, 2): the
    nozzle without p; levers (couplings, r); axes (couplings, 2): where these respond, and their
    command; command (q, 2): without p; bounds (11,): effort of x and y; from x, y to the belts, by
    rows; the least and then the greatest command; the belts' limit where nothing lowers it.
    """

    path: Array
    index: Integers
    dwell: slice
    weight: Array
    extruding: Flags
    known: Array
    levers: Array
    axes: Integers
    splines: Splines
    command: Array
    bounds: Array


def least_squares(problem: Problem) -> Array:
    """Return p (k, 2)."""
    if not (k := len(problem.splines.first)):
        return np.zeros((0, 2))
    q, splines, p = problem, problem.splines, np.empty((k, 2))
    fits = kernels.least_squares(
        q.path, q.index, len(q.index), q.dwell.start, q.dwell.stop, q.weight, q.extruding, q.known,
        q.levers, q.axes, len(q.axes), splines.by_p, splines.first, k, q.command, len(q.command),
        splines.N, splines.D, splines.bands, splines.limit, q.bounds, NEAREST, SEARCHES,
        EMPHASES, TRIALS, HARD_TRIALS, RULES, np.empty(ROOM), p,
    )  # fmt: skip
    assert fits
    return p
