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
point is sought twice: with the nozzle where it should be, then with where it came to be. Belts
that would be driven too hard get more weight in D, row by row, until they are not, and a command
that would leave the bed is pulled back likewise.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hframe_post.arrays import TS, Array, Integers, X, Y
from hframe_post.model.lpfbs import bsplines
from hframe_post.model.plant import Plant
from hframe_post.model.stop_filters import Filters, Lifted, State, judged
from hframe_post.model.stop_judged import BESIDE, BEYOND, Nozzle, Rows, Stop, Surroundings

GROWTH = (1, 1, 1, 1, 1, 1, 2, 2, 2, 3, 3, 4, 5, 6, 8, 10, 12, 14, 19)  # knots, from the stop on
DEGREE = 3

EFFORT_SHARE = 0.1  # of the effort elsewhere: a stop is short and asks for more
LEAST_EFFORT = 1e-3
WITHIN = 0.8  # share of the belts' acceleration that is used: firmware needs some to be in time
BARELY = 0.97 / WITHIN  # times that: what is used where nothing else traces the path
AT_HOLD = 0.5  # share of that next to the hold, where the firmware stops within one segment
SEARCHES, TRIALS = 2, 10  # of the nearest points; of the weights of D
MOST_MORE = 5.0  # times, in one trial
STEP = 0.7  # share of a limit from which on a row of D gets more weight
EASY, LESS = 0.4, 0.5  # share below which it gets less again, times that
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
        self._forced = [self._moving(G) for G in self.filters.all]

    def solve(self, around: Surroundings, command: Array, z: State, stop: Stop) -> Array:
        """The command (n, 2) of samples a − BESIDE … b + BESIDE − 1, from the origin.

        command: of the whole stretch, so far; z: the state of the filters before the first of
        these samples. The path must be known for NEAREST samples more on either side, and for
        BEYOND after.
        """
        rows = Rows.of(around, stop)
        columns = self._columns(stop)
        nozzle = self._nozzle(around, command, z, stop, columns)
        by_p, known = self._sequence(command, stop, columns)
        pressure = _Pressure.none(known, self._bed - around.origin[:, None])
        p = np.zeros(2 * len(columns))
        for search in range(SEARCHES):
            at = nozzle.at(p)
            foot, t = rows.nearest(at) if search else (rows.path, rows.direction)
            H, g = nozzle.normal_equations(p, rows, foot, t)
            p, pressure = self._within_limits(H, g, by_p, known, pressure)
        return self._changed(command, stop, columns, p)

    def _columns(self, stop: Stop) -> Integers:
        """Splines (before, hold, after) that this stop may use."""
        k = len(self._reach)
        before, after = (np.flatnonzero(self._reach <= n) for n in (stop.before, stop.after))
        hold = [k] if stop.held else []
        return np.concatenate([before, hold, k + 1 + after]).astype(np.int64)

    # ------------------------------------------------------------------ the nozzle

    def _moving(self, G: Lifted) -> tuple[Array, Array, Array]:
        """Outputs and state of the splines before the hold, outputs of those after it."""
        lifted, _, _, R = G.lifted(BESIDE)
        later = G.lifted(BESIDE + BEYOND)[0][:, :BESIDE]
        return lifted @ self._N_before, R @ self._N_before, later @ self._N_after

    def _nozzle(
        self, around: Surroundings, command: Array, z: State, stop: Stop, columns: Integers
    ) -> Nozzle:
        """Where it goes, known and by p: rows before, after, and in the hold."""
        a, b, n = stop.a, stop.b, stop.b - stop.a
        k = len(self._reach)
        hold = judged(n)
        index = np.concatenate([np.arange(a - BESIDE, a), np.arange(b, b + BESIDE + BEYOND)])
        outputs = []
        for G, s, i, (before, reached, after) in zip(
            self.filters.all, z, self.filters.inputs, self._forced, strict=True
        ):
            u, h = command[:, i], command[a, i]
            first, O, A, R = G.lifted(BESIDE)
            moved = u[a - BESIDE : a]
            state = A @ s + R @ moved
            forced = np.zeros((len(state), 2 * k + 1))  # state at a, by p
            forced[:, :k] = reached
            by_p = np.zeros((len(index) + len(hold), 2 * k + 1))
            free = np.empty(len(by_p))
            by_p[:BESIDE, :k], free[:BESIDE] = before, first @ moved + O @ s
            if n:
                by_state, by_input = G.held_output(n)
                by_p[len(index) :] = by_state @ forced
                by_p[len(index) :, k] = by_input
                free[len(index) :] = by_state @ state + by_input * h
            ring, step = G.standing(n)
            last, O, _, _ = G.lifted(BESIDE + BEYOND)
            forced = ring @ forced
            forced[:, k] = step
            later = slice(BESIDE, len(index))
            by_p[later] = O @ forced
            by_p[later, k + 1 :] += after
            free[later] = last @ u[b : b + BESIDE + BEYOND] + O @ (ring @ state + step * h)
            outputs.append((by_p[:, columns], free))
        where = np.concatenate([index, np.full(len(hold), a)])
        lever = around.path[where, X] + around.origin[X] - self.filters.x_c
        return Nozzle.of(outputs, lever)

    # ------------------------------------------------------------------ the command

    def _sequence(self, command: Array, stop: Stop, columns: Integers) -> tuple[Array, Array]:
        """The command by p (r, k), and known (r, 2), from two samples before to two after.

        Of the hold, as many as second differences see.
        """
        a, b, k = stop.a, stop.b, len(self._reach)
        held = min(b - a, 2)
        by_p = np.zeros((BESIDE + held + BESIDE + 4, 2 * k + 1))
        by_p[2 : 2 + BESIDE, :k] = self._N_before
        by_p[2 + BESIDE : 2 + BESIDE + held, k] = 1.0
        by_p[2 + BESIDE + held : -2, k + 1 :] = self._N_after
        hold = np.repeat(command[a : a + 1], held, axis=0)
        known = [command[a - BESIDE - 2 : a], hold, command[b : b + BESIDE + 2]]
        return by_p[:, columns], np.vstack(known)

    def _within_limits(
        self, H: Array, g: Array, by_p: Array, known: Array, pressure: _Pressure
    ) -> tuple[Array, _Pressure]:
        """The p with which belts and bed are kept to, and the pressure that it took."""
        k = by_p.shape[1]
        D, rates = np.diff(by_p, n=2, axis=0), np.diff(known, n=2, axis=0)
        limit = np.full(len(D), self._limit)
        limit[BESIDE : len(D) - BESIDE] *= AT_HOLD
        best, least = np.zeros(2 * k), (np.inf, np.inf)
        for _ in range(TRIALS):
            full, right = H.copy(), g.copy()
            for axis, effort in enumerate(self._effort):
                own = slice(axis * k, (axis + 1) * k)
                pulled = [(D, effort * pressure.effort, rates[:, axis])]
                if pressure.bed[:, axis].any():
                    inside = known[:, axis] - pressure.inside[:, axis]
                    pulled.append((by_p, pressure.bed[:, axis], inside))
                for rows, weight, off in pulled:
                    weighted = weight[:, None] * rows
                    full[own, own] += weighted.T @ rows
                    right[own] += weighted.T @ off
            full[np.diag_indices(2 * k)] += 1e-9 * full.diagonal().max(initial=0.0) + 1e-12
            p = -np.linalg.solve(full, right)
            added = p.reshape(2, k).T
            share = np.abs((rates + D @ added) @ self._belts.T).max(axis=1) / limit
            place = known + by_p @ added
            beyond = np.abs(np.clip(place, pressure.low, pressure.high) - place)
            excess = max(float(share.max()), 1.0) + float(beyond.max())
            cost = float(p @ (0.5 * (H @ p) + g))
            if (known_as := (max(excess, BARELY), cost)) < least:
                best, least = p, known_as
            if excess <= 1.0:
                break
            pressure = pressure.raised(share, beyond, place)
        return best, pressure

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
