r"""A stop: the command stands still while the machine does something else.

      command     ____                        ____
             ____/    \                      /    \____
                       \____________________/
                  before   hold: a … b − 1   after

Only what is printed counts: the nozzle's distance to the path while it extrudes. So the command
may leave the path during travel, may stand next to it, and may lag or lead along it. The command
around the stop minimises

    ‖W n·(nozzle − foot)‖² + ALONG ‖W t·(nozzle − path)‖² + λ‖E D command‖² + ‖B (command − bed)‖²

==============  =============================================================================
symbol          meaning
==============  =============================================================================
``N, p``        cubic splines, with knots closer together near the stop; their weights
``foot, t, n``  the path's nearest point to the nozzle, the directions along and across there
``W``           root of each sample's weight, see ``model.stop_cost``
``D, λ``        second difference, across the hold too; effort
``E, B``        roots of weights that keep the belts and the bed's edges within bounds
``z``           state of the plant's filters
==============  =============================================================================

The plant is linear and θ's lever arm is that of the path (Remark 2.1 of the paper), so this is a
linear least-squares problem for given feet. Its bounds are met by iteratively reweighted least
squares: a row that exceeds its bound gets more weight, and the problem is solved again.

1. Solve with the feet at the desired places; seek the feet of the nozzle so found; solve again.
2. In each solution, raise E where belts accelerate too hard, and B where the bed is left, up to
   TRIALS times. Keep the best command within the belts' limit.
3. While the nozzle is FAR from the path where it extrudes, raise W there and solve again, up to
   EMPHASES times. Keep the command with the least peak.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from hframe_post.arrays import TS, Array, Integers, X, Y
from hframe_post.model.lpfbs import bsplines
from hframe_post.model.plant import Plant
from hframe_post.model.stop_cost import BESIDE, FAR, Rows, Stop, Surroundings, reweighted
from hframe_post.model.stop_plant import Filters, State

SEARCHES, EMPHASES, TRIALS = 2, 3, 10  # iterations of steps 1, 3 and 2
USABLE = 0.8  # share of the belts' acceleration to use: firmware needs the rest to be in time
AT_HOLD = 0.5  # share of that next to the hold, where firmware stops within one segment
HARDEST = 0.97  # share of the belts' acceleration that no command may exceed if one can help it
EXCESS_COST = 0.2  # mm² for exceeding USABLE by as much again, next to the squared deviations
TARGET = 0.7  # share of its bound from which on a row of E is raised, so that it stays below
CLEARANCE = 0.02  # mm to the bed's edge for a command that would leave it
HOLD_ROWS = 2  # samples of a hold that second differences can tell apart


class StopSolver:
    """Solver of the commands around stops of one printer.

    plant: the one the strategy assumes; effort: λ of x and y; belts (2, 2): from x, y to the
    belts; acceleration: mm/s², the limit of the belts; bed: (least, greatest) of x and of y, mm.
    """

    def __init__(
        self,
        plant: Plant,
        effort: tuple[float, float],
        belts: Array,
        acceleration: float,
        bed: tuple[tuple[float, float], tuple[float, float]],
    ) -> None:
        # a tenth of the effort elsewhere, since a stop is short and asks for more
        self._effort = [max(0.1 * e, 1e-3) for e in effort]
        self._belts, self._limit = belts, USABLE * acceleration * TS**2
        self._bed = np.array(bed)
        away, self._reach = _graded_splines()
        self._N_before, self._N_after = away[::-1], away
        self.filters = Filters(plant, self._N_before, self._N_after)
        self._splines = lru_cache(maxsize=64)(self._usable_splines)

    def solve(self, around: Surroundings, command: Array, z: State, stop: Stop) -> Array:
        """Return the command (n, 2) of samples a − BESIDE … b + BESIDE − 1, from the origin.

        command: of the whole stretch, so far; z: the filters' state before the first of these
        samples. The path must be known for NEAREST samples more on either side, and for BEYOND
        after.
        """
        rows = Rows.from_stop(around, stop)
        a, b = stop.a, stop.b
        # with two samples more on either side for second differences, and a shortened hold
        hold = np.repeat(command[a : a + 1], min(b - a, HOLD_ROWS), axis=0)
        known = np.vstack([command[a - BESIDE - 2 : a], hold, command[b : b + BESIDE + 2]])
        splines = self._splines(stop.before, stop.after, stop.movable, len(hold))
        nozzle = self.filters.nozzle(around, command, z, stop, splines.columns)
        weights = _BoundWeights.initial(known, self._bed - around.origin[:, None])
        p = best = np.zeros(2 * len(splines.columns))
        least = np.inf
        for search in range(SEARCHES + EMPHASES):
            foot, t = rows.nearest(nozzle.at(p)) if search else (rows.path, rows.direction)
            H, g = nozzle.normal_equations(rows, foot, t)
            p, weights = self._bounded(H, g, splines, known, weights)
            if search < SEARCHES - 1:
                continue
            off = rows.off(nozzle.at(p))
            if (peak := float(off.max(initial=0.0))) < least:
                best, least = p, peak
            if least <= FAR:
                break
            rows = rows.emphasised(off)
        return self._changed(command, stop, splines.columns, best)

    def _bounded(
        self, H: Array, g: Array, splines: _Splines, known: Array, weights: _BoundWeights
    ) -> tuple[Array, _BoundWeights]:
        """Return p within the bounds of belts and bed, and the weights that this took."""
        D, rates = splines.D, np.diff(known, n=2, axis=0)
        limit = np.full(len(D), self._limit)
        limit[BESIDE : len(D) - BESIDE] *= AT_HOLD
        hardest = HARDEST / USABLE * self._limit
        best, kept, least = np.zeros(len(g)), weights, (np.inf, np.inf)
        for _ in range(TRIALS):
            p = self._weighted_solution(H, g, splines, known, rates, weights)
            added = p.reshape(2, -1).T
            share = np.abs((rates + D @ added) @ self._belts.T).max(axis=1) / limit
            place = known + splines.N @ added
            outside = np.abs(np.clip(place, weights.low, weights.high) - place)
            excess = max(float(share.max()), 1.0) + float(outside.max())
            hard = float((share * limit).max()) / hardest
            cost = float(p @ (0.5 * (H @ p) + g)) + EXCESS_COST * (excess - 1.0)
            if (rank := (max(hard, 1.0) + float(outside.max()), cost)) < least:
                best, kept, least = p, weights, rank
            if excess <= 1.0:
                break
            weights = weights.raised(share, outside, place)
        return best, kept

    def _weighted_solution(
        self, H: Array, g: Array, splines: _Splines, known: Array, rates: Array,
        weights: _BoundWeights,
    ) -> Array:  # fmt: skip
        """Return the p that minimises ½pᵀHp + gᵀp, the effort, and what leaves the bed."""
        N, D, k = splines.N, splines.D, splines.N.shape[1]
        H, g = H.copy(), g.copy()
        weighted_D = weights.effort[:, None] * D
        square = weighted_D.T @ D if (weights.effort != 1.0).any() else splines.square
        for axis, effort in enumerate(self._effort):
            half = slice(axis * k, (axis + 1) * k)
            H[half, half] += effort * square
            g[half] += effort * (weighted_D.T @ rates[:, axis])
            if weights.bed[:, axis].any():
                weighted_N = weights.bed[:, axis, None] * N
                H[half, half] += weighted_N.T @ N
                g[half] += weighted_N.T @ (known[:, axis] - weights.inside[:, axis])
        H[np.diag_indices(2 * k)] += 1e-9 * H.diagonal().max(initial=0.0) + 1e-12  # regular
        return np.asarray(-np.linalg.solve(H, g))

    def _changed(self, command: Array, stop: Stop, columns: Integers, p: Array) -> Array:
        a, b, k = stop.a, stop.b, len(self._reach)
        changed = command[a - BESIDE : b + BESIDE].copy()
        for axis in (X, Y):
            added = np.zeros(2 * k + 1)
            added[columns] = p[axis * len(columns) : (axis + 1) * len(columns)]
            changed[:BESIDE, axis] += self._N_before @ added[:k]
            changed[BESIDE : len(changed) - BESIDE, axis] = command[a, axis] + added[k]
            changed[len(changed) - BESIDE :, axis] += self._N_after @ added[k + 1 :]
        return changed

    def _usable_splines(self, before: int, after: int, movable: bool, hold: int) -> _Splines:
        """Return the splines of a stop that may change ``before`` and ``after`` samples next to it.

        movable: whether its own place may change too; hold: rows of D that it has.
        """
        k = len(self._reach)
        first, last = (np.flatnonzero(self._reach <= n) for n in (before, after))
        columns = np.concatenate([first, [k] if movable else [], k + 1 + last]).astype(np.int64)
        N = np.zeros((BESIDE + hold + BESIDE + 4, 2 * k + 1))
        N[2 : 2 + BESIDE, :k] = self._N_before
        N[2 + BESIDE : 2 + BESIDE + hold, k] = 1.0
        N[2 + BESIDE + hold : -2, k + 1 :] = self._N_after
        N = N[:, columns]
        D = np.diff(N, n=2, axis=0)
        return _Splines(columns, N, D, D.T @ D)


@dataclass(frozen=True, slots=True)
class _Splines:
    """The usable ones of all splines and the hold.

    columns: which these are; N (r, k): the command by p, from two samples before to two after;
    D (r − 2, k): its second differences; square: DᵀD.
    """

    columns: Integers
    N: Array
    D: Array
    square: Array


@dataclass(frozen=True, slots=True)
class _BoundWeights:
    """Weights that keep a command (r, 2) within bounds, row by row.

    effort (r − 2,): E², factors of λ; bed (r, 2): B², on the distance to ``inside`` (r, 2); low,
    high (2,): edges of the bed from the origin.
    """

    effort: Array
    bed: Array
    inside: Array
    low: Array
    high: Array

    @classmethod
    def initial(cls, known: Array, bed: Array) -> _BoundWeights:
        nothing = np.zeros_like(known)
        return cls(np.ones(len(known) - 2), nothing, nothing, bed[:, 0], bed[:, 1])

    def raised(self, share: Array, outside: Array, place: Array) -> _BoundWeights:
        """Return more weight on belts at a great ``share`` of their bound, and outside the bed.

        Belts at a small share of it get less again: the command is more sluggish than it must be.
        """
        factor = reweighted(share / TARGET, gain=2.0, most=5.0)
        factor[share < 0.4] = 0.5
        out = outside > 0.0
        inwards = np.clip(place, self.low + CLEARANCE, self.high - CLEARANCE)
        return replace(
            self,
            effort=np.maximum(self.effort * factor, 1.0),
            bed=np.where(out, np.maximum(10.0 * self.bed, 1.0), self.bed),
            inside=np.where(out, inwards, self.inside),
        )


def _graded_splines() -> tuple[Array, Array]:
    """Return splines at 1 … BESIDE samples from a stop (BESIDE, k), and how far each reaches (k,).

    They are free at the stop and end smoothly at zero on the far side.
    """
    degree = 3
    spacing = (1, 1, 1, 1, 1, 1, 2, 2, 2, 3, 3, 4, 5, 6, 8, 10, 12, 14, 19)  # from the stop on
    inner = np.concatenate([[0.0], np.cumsum(spacing, dtype=float)])
    inner = inner[inner <= BESIDE]
    beyond = inner[-1] + 1.0 + np.arange(degree)
    knots = np.concatenate([np.zeros(degree), inner, beyond])
    N = bsplines(knots, degree, np.minimum(np.arange(1.0, BESIDE + 1.0), knots[-1]))
    reach = knots[degree + 1 :]
    inside = reach <= inner[-1]
    return N[:, inside], reach[inside]
