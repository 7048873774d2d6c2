r"""A stop: the command stands while the machine does something else, and the path waits for it.

      command     ____                        ____
             ____/    \                      /    \____
                       \____________________/
                  before   hold: a … b − 1   after

What is printed is judged, and nothing else: the nozzle's distance to the path while it
extrudes. So the command may leave the path where it travels, may stand beside it, and may lag or
lead along it. Minimised over the command next to the stop is

    ‖W_n n·(nozzle − foot)‖² + ‖W_t t·(nozzle − path)‖² + λ‖D command‖²

==============  =============================================================================
symbol          meaning
==============  =============================================================================
``N, p``        cubic splines whose knots lie the closer the nearer the stop; their weights
``foot, t, n``  the path's nearest point to the nozzle, the directions along and across there
``W``           the root of each sample's weight
``D``           second difference, across the hold too
``z``           state of the plant's filters, in the order of ``Filters``
==============  =============================================================================

The plant is linear, θ's lever arm is that of the path (Remark 2.1 of the paper), and the nearest
point is sought twice: with the nozzle where it should be, then with where it came to be. Where
it is still far from what it prints, those samples weigh more, and the least peak is taken. Belts
that would be driven too hard get more weight in D, row by row, until they are not, and a command
that would leave the bed is pulled back likewise.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from hframe_post.arrays import TS, Array, Integers, X, Y
from hframe_post.model.lpfbs import bsplines
from hframe_post.model.plant import Plant
from hframe_post.model.stop_cost import (
    BESIDE,
    BEYOND,
    FAR,
    Nozzle,
    Rows,
    Stop,
    Surroundings,
    judged,
    sampled,
)
from hframe_post.model.stop_plant import Filters, Response, State

GROWTH = (1, 1, 1, 1, 1, 1, 2, 2, 2, 3, 3, 4, 5, 6, 8, 10, 12, 14, 19)  # knots, from the stop on
DEGREE = 3

EFFORT_SHARE = 0.1  # of the effort elsewhere: a stop is short and asks for more
LEAST_EFFORT = 1e-3
WITHIN = 0.8  # share of the belts' acceleration that is used: firmware needs some to be in time
BARELY = 0.97 / WITHIN  # times that: what is used where nothing else traces the path
MORE_COSTS = 0.2  # mm² for the whole of WITHIN once more, beside the squares of deviations
AT_HOLD = 0.5  # share of that next to the hold, where the firmware stops within one segment
SEARCHES, TRIALS = 2, 10  # of the nearest points; of the weights of D
EMPHASES = 3  # more searches, where the nozzle is FAR from a path on which filament is laid
MOST_MORE = 5.0  # times, in one trial
STEP = 0.7  # share of a limit from which on a row of D gets more weight
EASY, LESS = 0.4, 0.5  # share below which it gets less again, times that
SEEN = 2  # samples of a hold, by second differences
USUAL = 64  # choices of splines that are remembered
CLEAR = 0.02  # mm to the ends of the bed, for a command that would leave it


class StopSolver:
    """Finds the command around stops of one printer.

    plant: as the strategy believes it; effort: λ of x and y; belts (2, 2): from x, y to the
    belts; acceleration: mm/s², the most that the belts may be asked; bed: (least, greatest) of
    x and of y, mm.
    """

    def __init__(
        self,
        plant: Plant,
        effort: tuple[float, float],
        belts: Array,
        acceleration: float,
        bed: tuple[tuple[float, float], tuple[float, float]],
    ) -> None:
        self.filters = Filters(plant)
        self._effort = [max(EFFORT_SHARE * e, LEAST_EFFORT) for e in effort]
        self._belts, self._limit = belts, WITHIN * acceleration * TS**2
        self._bed = np.array(bed)
        away, self._reach = _graded_splines()
        self._N_before, self._N_after = away[::-1], away
        self._responses = [Response(G, self._N_before, self._N_after) for G in self.filters.all]
        self._splines = lru_cache(maxsize=USUAL)(self._splines_of)

    def solve(self, around: Surroundings, command: Array, z: State, stop: Stop) -> Array:
        """The command (n, 2) of samples a − BESIDE … b + BESIDE − 1, from the origin.

        command: of the whole stretch, so far; z: the state of the filters before the first of
        these samples. The path must be known for NEAREST samples more on either side, and for
        BEYOND after.
        """
        rows = Rows.of(around, stop)
        splines = self._splines(stop.before, stop.after, stop.held, min(stop.b - stop.a, SEEN))
        nozzle = self._nozzle(around, command, z, stop, splines.columns)
        known = _sequence(command, stop)
        pressure = _Pressure.none(known, self._bed - around.origin[:, None])
        p = best = np.zeros(2 * len(splines.columns))
        least = np.inf
        for search in range(SEARCHES + EMPHASES):
            foot, t = rows.nearest(nozzle.at(p)) if search else (rows.path, rows.direction)
            H, g = nozzle.normal_equations(rows, foot, t)
            p, pressure = self._within_limits(H, g, splines, known, pressure)
            if search < SEARCHES - 1:
                continue
            off = rows.off(nozzle.at(p))
            if (farthest := float(off.max(initial=0.0))) < least:
                best, least = p, farthest
            if least <= FAR:
                break
            rows = rows.emphasised(off)
        return self._changed(command, stop, splines.columns, best)

    def _splines_of(self, before: int, after: int, held: bool, seen: int) -> _Splines:
        """Those that a stop may use which changes so many samples; the hold is as long as seen."""
        k = len(self._reach)
        first, last = (np.flatnonzero(self._reach <= n) for n in (before, after))
        columns = np.concatenate([first, [k] if held else [], k + 1 + last]).astype(np.int64)
        by_p = np.zeros((BESIDE + seen + BESIDE + 4, 2 * k + 1))
        by_p[2 : 2 + BESIDE, :k] = self._N_before
        by_p[2 + BESIDE : 2 + BESIDE + seen, k] = 1.0
        by_p[2 + BESIDE + seen : -2, k + 1 :] = self._N_after
        return _Splines.of(columns, by_p[:, columns])

    # ------------------------------------------------------------------ the nozzle

    def _nozzle(
        self, around: Surroundings, command: Array, z: State, stop: Stop, columns: Integers
    ) -> Nozzle:
        """Where it goes, known and by p: rows before, after, and in the hold."""
        a, b, n = stop.a, stop.b, stop.b - stop.a
        outputs = []
        for response, s, i in zip(self._responses, z, self.filters.inputs, strict=True):
            u = command[:, i]
            known = response.known(s, u[a - BESIDE : a], u[a], u[b : b + BESIDE + BEYOND], n)
            outputs.append((response.by_splines(n)[:, columns], known))
        index = sampled(stop)
        where = np.concatenate([index, np.full(len(judged(n)), a)])
        lever = around.path[where, X] + around.origin[X] - self.filters.x_c
        return Nozzle.of(outputs, lever)

    # ------------------------------------------------------------------ the command

    def _within_limits(
        self, H: Array, g: Array, splines: _Splines, known: Array, pressure: _Pressure
    ) -> tuple[Array, _Pressure]:
        """The p with which belts and bed are kept to, and the pressure that it took."""
        by_p, D, rates = splines.by_p, splines.D, np.diff(known, n=2, axis=0)
        k = by_p.shape[1]
        limit = np.full(len(D), self._limit)
        limit[BESIDE : len(D) - BESIDE] *= AT_HOLD
        best, kept, least = np.zeros(2 * k), pressure, (np.inf, np.inf)
        for _ in range(TRIALS):
            full, right = H.copy(), g.copy()
            weighted = pressure.effort[:, None] * D
            square = weighted.T @ D if (pressure.effort != 1.0).any() else splines.square
            for axis, effort in enumerate(self._effort):
                own = slice(axis * k, (axis + 1) * k)
                full[own, own] += effort * square
                right[own] += effort * (weighted.T @ rates[:, axis])
                if pressure.bed[:, axis].any():
                    pulled = pressure.bed[:, axis, None] * by_p
                    full[own, own] += pulled.T @ by_p
                    right[own] += pulled.T @ (known[:, axis] - pressure.inside[:, axis])
            full[np.diag_indices(2 * k)] += 1e-9 * full.diagonal().max(initial=0.0) + 1e-12
            p = -np.linalg.solve(full, right)
            added = p.reshape(2, k).T
            share = np.abs((rates + D @ added) @ self._belts.T).max(axis=1) / limit
            place = known + by_p @ added
            beyond = np.abs(np.clip(place, pressure.low, pressure.high) - place)
            excess = max(float(share.max()), 1.0) + float(beyond.max())
            hard = float((share * limit).max()) / (BARELY * self._limit)  # next to the hold, too
            cost = float(p @ (0.5 * (H @ p) + g)) + MORE_COSTS * (excess - 1.0)
            if (known_as := (max(hard, 1.0) + float(beyond.max()), cost)) < least:
                best, kept, least = p, pressure, known_as
            if excess <= 1.0:
                break
            pressure = pressure.raised(share, beyond, place)
        return best, kept

    def _changed(self, command: Array, stop: Stop, columns: Integers, p: Array) -> Array:
        """The command with what p adds."""
        a, b, k = stop.a, stop.b, len(self._reach)
        changed = command[a - BESIDE : b + BESIDE].copy()
        for axis in (X, Y):
            added = np.zeros(2 * k + 1)
            added[columns] = p[axis * len(columns) : (axis + 1) * len(columns)]
            changed[:BESIDE, axis] += self._N_before @ added[:k]
            changed[BESIDE : len(changed) - BESIDE, axis] = command[a, axis] + added[k]
            changed[len(changed) - BESIDE :, axis] += self._N_after @ added[k + 1 :]
        return changed


@dataclass(frozen=True, slots=True)
class _Splines:
    """The command by p, (r, k), from two samples before to two after, and what follows from it.

    columns: which of all splines and the hold these are; D (r − 2, k): second differences;
    square: DᵀD.
    """

    columns: Integers
    by_p: Array
    D: Array
    square: Array

    @classmethod
    def of(cls, columns: Integers, by_p: Array) -> _Splines:
        """With these columns."""
        D = np.diff(by_p, n=2, axis=0)
        return cls(columns, by_p, D, D.T @ D)


@dataclass(frozen=True, slots=True)
class _Pressure:
    """Weights that keep a command (r, 2) within limits, row by row.

    effort (r − 2,): factors of λ; bed (r, 2): on the distance to ``inside`` (r, 2); low, high
    (2,): ends of the bed from the origin.
    """

    effort: Array
    bed: Array
    inside: Array
    low: Array
    high: Array

    @classmethod
    def none(cls, known: Array, bed: Array) -> _Pressure:
        """To begin with."""
        nothing = np.zeros_like(known)
        return cls(np.ones(len(known) - 2), nothing, nothing, bed[:, 0], bed[:, 1])

    def raised(self, share: Array, beyond: Array, place: Array) -> _Pressure:
        """More where belts are driven to more than a STEP of their limit, or the bed is left.

        Less again where that has made the command more sluggish than it must be.
        """
        more = np.minimum(2.0 * np.square(share / STEP), MOST_MORE)
        changed = np.where(share > STEP, more, np.where(share < EASY, LESS, 1.0))
        effort = np.maximum(self.effort * changed, 1.0)
        out = beyond > 0.0
        bed = np.where(out, np.maximum(10.0 * self.bed, 1.0), self.bed)
        inwards = np.clip(place, self.low + CLEAR, self.high - CLEAR)
        return replace(self, effort=effort, bed=bed, inside=np.where(out, inwards, self.inside))


def _sequence(command: Array, stop: Stop) -> Array:
    """The command (r, 2) from two samples before to two after, of the hold no more than SEEN."""
    a, b = stop.a, stop.b
    hold = np.repeat(command[a : a + 1], min(b - a, SEEN), axis=0)
    return np.vstack([command[a - BESIDE - 2 : a], hold, command[b : b + BESIDE + 2]])


def _graded_splines() -> tuple[Array, Array]:
    """Splines at 1 … BESIDE samples from a stop (BESIDE, k), and how far each reaches (k,).

    They end at the stop with all freedom, and at their far ends smoothly at nothing.
    """
    inner = np.concatenate([[0.0], np.cumsum(GROWTH, dtype=float)])
    inner = inner[inner <= BESIDE]
    beyond = inner[-1] + 1.0 + np.arange(DEGREE)
    knots = np.concatenate([np.zeros(DEGREE), inner, beyond])
    N = bsplines(knots, DEGREE, np.minimum(np.arange(1.0, BESIDE + 1.0), knots[-1]))
    reach = knots[DEGREE + 1 :]
    inside = reach <= inner[-1]
    return N[:, inside], reach[inside]
