"""The least squares of one stop, in C and in numpy. Symbols are those of ``model.stop``.

C takes the terms of all sums in order. numpy would need five times as long for that, so it leaves
``_times`` and ``_solved`` to BLAS and LAPACK; with these in order, both give the same bits.

p is (k, 2): the weights of k splines, in the order in which these begin, for x and y. In matrices
x and y alternate, so that a row in time has a prefix of columns only.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hframe_post.arrays import Array, Flags, Integers, X, Y
from hframe_post.native import kernel

NEAREST = 24  # samples to either side in which the path's nearest point is sought; C takes no other
ALONG = 0.01  # times the weight of a squared deviation across the path, for that along it
FAR = 0.05  # mm off the path beyond which an extruding sample gets more weight
SEARCHES, EMPHASES, TRIALS = 2, 3, 10  # iterations of steps 1, 3 and 2
EMPHASIS, MOST_EMPHASIS = 1.5, 10.0  # factors of weights where the nozzle is FAR
TARGET = 0.7  # share of its bound from which on a row of E is raised, so that it stays below
EASY = 0.4  # share of its bound below which a row of E is lowered again
RAISED, MOST_RAISED = 2.0, 5.0  # factors of E²
HARDEST = 0.97 / 0.8  # times its bound, an acceleration that is exceeded only if it must be
EXCESS_COST = 0.2  # mm² for exceeding a bound by as much again, next to the squared deviations
SHORT2 = 1e-14  # mm², squared length up to which a vector has no direction
ROOM = 45_000  # numbers that the compiled loop needs to work in; C takes no fewer
CLEARANCE = 0.02  # mm to the bed's edge for a command that would leave it


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
    command; command (q, 2): without p; effort (2,); belts (2, 2): from x, y; full_limit: of theirs,
    where nothing lowers it; bed (2, 2): least and greatest command.
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
    effort: Array
    belts: Array
    full_limit: float
    bed: Array

    def nozzle(self, p: Array) -> Array:
        """Return the nozzle at the rows, (r, 2)."""
        x, y, *outputs = self.splines.by_p
        moved = np.column_stack([_times(p[:, X], x.T), _times(p[:, Y], y.T)])
        for (answer, command), lever, output in zip(self.axes, self.levers, outputs, strict=True):
            moved[:, answer] += lever * _times(p[:, command], output.T)
        return np.asarray(self.known + moved)


def least_squares(problem: Problem) -> Array:
    """Return p (k, 2)."""
    if not (k := len(problem.splines.first)):
        return np.zeros((0, 2))
    if (compiled := kernel("least_squares")) is None:
        return _solution(problem)
    q, splines, p = problem, problem.splines, np.empty((k, 2))
    bounds = np.concatenate([q.effort, q.belts.ravel(), q.bed.T.ravel(), [q.full_limit]])
    rules = np.array([
        ALONG, FAR, EMPHASIS, MOST_EMPHASIS, TARGET, EASY, RAISED, MOST_RAISED, HARDEST,
        EXCESS_COST, SHORT2, CLEARANCE,
    ])  # fmt: skip
    fits = compiled(
        q.path, q.index, len(q.index), q.dwell.start, q.dwell.stop, q.weight, q.extruding, q.known,
        q.levers, q.axes, len(q.axes), splines.by_p, splines.first, k, q.command, len(q.command),
        splines.N, splines.D, splines.bands, splines.limit, bounds, NEAREST, SEARCHES,
        EMPHASES, TRIALS, rules, np.empty(ROOM), p,
    )  # fmt: skip
    assert fits
    return p


def _solution(problem: Problem) -> Array:
    path = _Path.from_problem(problem)
    weight, bounds = problem.weight, _BoundWeights.initial(problem)
    p = best = np.zeros((len(problem.splines.first), 2))
    least = np.inf
    for search in range(SEARCHES + EMPHASES):
        foot, t = path.nearest(problem.nozzle(p)) if search else (path.place, path.direction)
        squares = _squares(problem, weight, path.place, foot, t)
        p, bounds = _bounded(squares, problem, bounds)
        if search < SEARCHES - 1:
            continue
        nozzle = problem.nozzle(p)
        off = nozzle - path.nearest(nozzle)[0]
        distance = np.where(problem.extruding, _length(off), 0.0)
        if (peak := float(distance.max(initial=0.0))) < least:
            best, least = p, peak
        if least <= FAR:
            break
        weight = weight * _reweighted(distance / FAR, EMPHASIS, MOST_EMPHASIS)
    return best


@dataclass(frozen=True, slots=True)
class _Path:
    """The path around each row: place, direction (r, 2); from, step (r, 2·NEAREST, 2): pieces;
    share (r, 2·NEAREST): factor from a product with a piece to a share of it; short: which
    pieces have no direction, so that a place on one is as near on a neighbour that has."""

    place: Array
    direction: Array
    start: Array
    step: Array
    share: Array
    short: Flags

    @classmethod
    def from_problem(cls, problem: Problem) -> _Path:
        around = problem.path[problem.index[:, None] + np.arange(-NEAREST, NEAREST + 1)]
        around[problem.dwell] = around[problem.dwell, NEAREST, None]
        start, step = around[:, :-1], np.diff(around, axis=1)
        length2 = np.square(step[..., X]) + np.square(step[..., Y])
        direction = _unit(step[:, NEAREST], np.array([1.0, 0.0]))
        share, short = 1.0 / np.maximum(length2, 1e-18), length2 <= SHORT2
        return cls(around[:, NEAREST], direction, start, step, share, short)

    def nearest(self, at: Array) -> tuple[Array, Array]:
        """Return the path's nearest points to the nozzle and its directions there, (r, 2)."""
        to = at[:, None] - self.start
        along = (to[..., X] * self.step[..., X] + to[..., Y] * self.step[..., Y]) * self.share
        along = np.minimum(np.maximum(along, 0.0), 1.0)[..., None]
        off = to - along * self.step
        distance2 = np.square(off[..., X]) + np.square(off[..., Y])
        distance2[self.short] = np.inf
        best = distance2.argmin(axis=1)
        piece = np.arange(len(best)), best
        foot = self.start[piece] + along[piece] * self.step[piece]
        return foot, _unit(self.step[piece], self.direction)


def _squares(problem: Problem, weight: Array, place: Array, foot: Array, t: Array) -> Array:
    """Return H and g of ½pᵀHp + gᵀp, the weighted squares, as [H g]."""
    (x, y, *outputs), k = problem.splines.by_p, len(problem.splines.first)
    normal = np.sqrt(weight)
    along = np.full(len(weight), np.sqrt(ALONG))
    along[problem.dwell] = 1.0
    along *= normal
    J = np.empty((len(weight), 2, 2 * k + 1))  # and the residual
    for row, to, n_x, n_y in (
        (J[:, 0], foot, -normal * t[:, Y], normal * t[:, X]),
        (J[:, 1], place, along * t[:, X], along * t[:, Y]),
    ):
        row[:, 0:-1:2] = n_x[:, None] * x
        row[:, 1:-1:2] = n_y[:, None] * y
        for (answer, command), lever, output in zip(
            problem.axes, problem.levers, outputs, strict=True
        ):
            row[:, command:-1:2] += ((n_x, n_y)[answer] * lever)[:, None] * output
        off = problem.known - to
        row[:, -1] = n_x * off[:, X] + n_y * off[:, Y]
    rows = J.reshape(-1, 2 * k + 1)
    return _times(rows[:, :-1].T, rows)


def _bounded(
    squares: Array, problem: Problem, weights: _BoundWeights
) -> tuple[Array, _BoundWeights]:
    """Return p within the bounds of belts and bed, and the weights that this took."""
    N, D, known = problem.splines.N, problem.splines.D, problem.command
    rates, low, high = np.diff(known, n=2, axis=0), *problem.bed.T
    hardest = HARDEST * problem.full_limit
    best, kept, least = np.zeros((len(problem.splines.first), 2)), weights, (np.inf, np.inf)
    for _ in range(TRIALS):
        p = -_solved(weights.added(squares, problem, rates)).reshape(-1, 2)
        acceleration = np.abs(_times(rates + _times(D, p), problem.belts.T)).max(axis=1)
        share = acceleration / problem.splines.limit
        place = known + _times(N, p)
        outside = np.abs(np.minimum(np.maximum(place, low), high) - place)
        excess = max(float(share.max()), 1.0) + float(outside.max())
        hard = max(float(acceleration.max()) / hardest, 1.0) + float(outside.max())
        cost = _cost(squares, p.ravel()) + EXCESS_COST * (excess - 1.0)
        if (rank := (hard, cost)) < least:
            best, kept, least = p, weights, rank
        if excess <= 1.0:
            break
        weights = weights.raised(share, outside, place, problem.bed)
    return best, kept


@dataclass(frozen=True, slots=True)
class _BoundWeights:
    """Weights that keep the command within bounds.

    effort (q − 2,): E², factors of λ; bed (q, 2): B², on the distance to ``inside`` (q, 2).
    """

    effort: Array
    bed: Array
    inside: Array

    @classmethod
    def initial(cls, problem: Problem) -> _BoundWeights:
        nothing = np.zeros_like(problem.command)
        return cls(np.ones(len(nothing) - 2), nothing, nothing)

    def added(self, squares: Array, problem: Problem, rates: Array) -> Array:
        """Return [H g] with the effort and the cost of leaving the bed."""
        splines, squares, n = problem.splines, squares.copy(), len(squares)
        D = self.effort[:, None] * splines.D
        square, gradient = _times(D.T, splines.D), _times(rates.T, D)
        for axis, effort in enumerate(problem.effort):
            squares[axis:n:2, axis:n:2] += effort * square
            squares[axis:n:2, -1] += effort * gradient[axis]
            if self.bed[:, axis].any():
                N = self.bed[:, axis, None] * splines.N
                squares[axis:n:2, axis:n:2] += _times(N.T, splines.N)
                outside = problem.command[:, axis] - self.inside[:, axis]
                squares[axis:n:2, -1] += _times(outside, N)
        diagonal = np.arange(n)
        greatest = squares[diagonal, diagonal].max(initial=0.0)
        squares[diagonal, diagonal] += 1e-9 * greatest + 1e-12  # regular
        return squares

    def raised(self, share: Array, outside: Array, place: Array, bed: Array) -> _BoundWeights:
        """Return more weight on belts at a great ``share`` of their bound, and outside the bed.

        Belts at a small share of it get less again: the command is more sluggish than it must be.
        """
        factor = _reweighted(share / TARGET, RAISED, MOST_RAISED)
        factor[share < EASY] = 0.5
        out, (low, high) = outside > 0.0, bed.T
        inwards = np.minimum(np.maximum(place, low + CLEARANCE), high - CLEARANCE)
        return replace(
            self,
            effort=np.maximum(self.effort * factor, 1.0),
            bed=np.where(out, np.maximum(10.0 * self.bed, 1.0), self.bed),
            inside=np.where(out, inwards, self.inside),
        )


def _cost(squares: Array, p: Array) -> float:
    H, g = squares[:, :-1], squares[:, -1]
    return float(np.cumsum(p * (0.5 * np.diag(H) * p + _times(p, np.triu(H, 1).T) + g))[-1])


def _times(A: Array, B: Array) -> Array:
    return np.asarray(A @ B)


def _solved(squares: Array) -> Array:
    """Return H⁻¹g of [H g]."""
    return np.asarray(np.linalg.solve(squares[:, :-1], squares[:, -1]))


def _reweighted(ratio: Array, gain: float, most: float) -> Array:
    """Return the factors of least-squares weights for rows at ``ratio`` (n,) of their target.

    A row beyond its target gets more weight: gain·ratio², at most ``most`` times.
    """
    return np.where(ratio > 1.0, np.minimum(gain * np.square(ratio), most), 1.0)


def _length(vector: Array) -> Array:
    """Return lengths (r,), as all processors compute them, unlike ``hypot``."""
    return np.asarray(np.sqrt(np.square(vector[:, X]) + np.square(vector[:, Y])))


def _unit(vector: Array, otherwise: Array) -> Array:
    """Return directions (r, 2), or another's where a vector is too short to have one."""
    length2 = np.square(vector[:, :1]) + np.square(vector[:, 1:])
    length = np.sqrt(np.maximum(length2, SHORT2))
    return np.asarray(np.where(length2 > SHORT2, vector / length, otherwise))
