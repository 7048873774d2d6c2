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
from functools import lru_cache

import numpy as np
from scipy.linalg.blas import dsymv, dsyrk
from scipy.linalg.lapack import dposv

from hframe_post.arrays import TS, Array, Flags, Integers, X, Y
from hframe_post.model.lpfbs import bsplines
from hframe_post.model.plant import Plant
from hframe_post.model.transfer_function import BLOCK_SAMPLES, TransferFunction

BESIDE = 100  # samples before and after a stop in which its command may change
BEYOND = 100  # samples after these that are still judged: what rings, shows there
NEAREST = 24  # samples to either side in which the path's nearest point is sought
GROWTH = (1, 1, 1, 1, 1, 1, 2, 2, 2, 3, 3, 4, 5, 6, 8, 10, 12, 14, 19)  # knots, from the stop on
DEGREE = 3

TRAVELLING = 0.03  # weight of a sample that does not extrude; of one that does: 1
STANDING = 0.04  # weight of a sample of the hold, of which every STRIDE-th counts
ARRIVING = 1.0  # weight of the hold's last sample where an extrusion begins there
ALONG = 0.01  # weight of a deviation along the path; of one across: 1
STRIDE, SWING = 4, 64  # samples between those of a hold, and how far into it
SOON = 25  # samples after a hold in which an extrusion begins there
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

STOPS = {"fast": 2, "exact": 8}  # samples of standstill of the path before and after a stop

DURATIONS = 128  # of holds, that are remembered

State = tuple[Array, ...]


class Filters:
    """The plant's transfer functions with their states: x, y and, where it racks, θ."""

    def __init__(self, plant: Plant) -> None:
        self.x_c = plant.x_c
        racks = (plant.Gxtheta,) if plant.Gxtheta is not None else ()
        self.all = tuple(_Lifted(G) for G in (plant.Gxx, plant.Gyy, *racks))
        self.inputs = (X, Y, X)[: len(self.all)]
        self.rest: State = tuple(np.zeros(G.order) for G in self.all)

    def after(self, z: State, command: Array) -> State:
        """The states after the next samples of the command (n, 2)."""
        blocks, rest = divmod(len(command), BLOCK_SAMPLES)
        whole = blocks * BLOCK_SAMPLES
        states = []
        for G, s, i in zip(self.all, z, self.inputs, strict=True):
            u = np.ascontiguousarray(command[:, i])
            _, _, A, R = G.lifted(BLOCK_SAMPLES)
            # block by block, so that the bits do not depend on how many there are
            for reached in np.matmul(R, u[:whole].reshape(blocks, BLOCK_SAMPLES, 1))[..., 0]:
                s = A @ s + reached
            if rest:
                _, _, A, R = G.lifted(rest)
                s = A @ s + R @ u[whole:]
            states.append(s)
        return tuple(states)


class _Lifted:
    """One transfer function over blocks of samples, and while its input stands (remembered)."""

    def __init__(self, G: TransferFunction) -> None:
        self.order, self.lifted = G.order, lru_cache(maxsize=BLOCK_SAMPLES + 2)(G.lifted)
        self._A, B, self._C, self._D = G.state_space
        self._equilibrium = np.linalg.solve(np.eye(G.order) - self._A, B)
        self.standing = lru_cache(maxsize=DURATIONS)(self._stood)
        self.held_output = lru_cache(maxsize=DURATIONS)(self._held_output)

    def _stood(self, n: int) -> tuple[Array, Array]:
        """State after n samples at an input h: first @ state + second · h."""
        ring = np.linalg.matrix_power(self._A, n)
        return ring, self._equilibrium - ring @ self._equilibrium

    def _held_output(self, n: int) -> tuple[Array, Array]:
        """Output at the judged samples of a hold of n: (r, d) by the state, (r,) by the input."""
        stood = [self.standing(samples) for samples in _judged(n)]
        by_state = np.array([self._C @ ring for ring, _ in stood]).reshape(len(stood), self.order)
        by_input = np.array([self._C @ step + self._D for _, step in stood])
        return by_state, by_input


@dataclass(frozen=True, slots=True)
class Stop:
    """A stop in a stretch of samples: the command stands from sample a to b − 1.

    before, after: samples on either side that may change; held: whether the place of the hold
    may. ends: the first sample after b that counts no more, since another stop begins there.
    """

    a: int
    b: int
    before: int
    after: int
    held: bool
    ends: int


@dataclass(frozen=True, slots=True)
class Surroundings:
    """n samples of a stretch: path (n, 2) from its origin (2,), mm; extruding (n,)."""

    path: Array
    origin: Array
    extruding: Flags


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
        rows = _Rows.of(around, stop)
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

    def _moving(self, G: _Lifted) -> tuple[Array, Array, Array]:
        """Outputs and state of the splines before the hold, outputs of those after it."""
        lifted, _, _, R = G.lifted(BESIDE)
        later = G.lifted(BESIDE + BEYOND)[0][:, :BESIDE]
        return lifted @ self._N_before, R @ self._N_before, later @ self._N_after

    def _nozzle(
        self, around: Surroundings, command: Array, z: State, stop: Stop, columns: Integers
    ) -> _Nozzle:
        """Where it goes, known and by p: rows before, after, and in the hold."""
        a, b, n = stop.a, stop.b, stop.b - stop.a
        k = len(self._reach)
        hold = _judged(n)
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
        return _Nozzle.of(outputs, lever)

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
            p = -dposv(full, right, lower=True)[1]
            added = p.reshape(2, k).T
            share = np.abs((rates + D @ added) @ self._belts.T).max(axis=1) / limit
            place = known + by_p @ added
            beyond = np.abs(np.clip(place, pressure.low, pressure.high) - place)
            excess = max(float(share.max()), 1.0) + float(beyond.max())
            cost = float(p @ (0.5 * dsymv(1.0, H, p, lower=True) + g))
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


@dataclass(frozen=True, slots=True)
class _Nozzle:
    """x and y of the nozzle: free (r, 2), and by p (r, 2k) each."""

    free: Array
    x: Array
    y: Array

    @classmethod
    def of(cls, outputs: list[tuple[Array, Array]], lever: Array) -> _Nozzle:
        """From the filters' outputs: eq. 1 and 2 of the paper with the lever arm of the path."""
        (x, free_x), (y, free_y), *racking = outputs
        across = np.zeros_like(x)
        for theta, free in racking:
            across, free_y = lever[:, None] * theta, free_y + lever * free
        nothing = np.zeros_like(y)
        return cls(
            np.column_stack([free_x, free_y]), np.hstack([x, nothing]), np.hstack([across, y])
        )

    def at(self, p: Array) -> Array:
        """Places (r, 2)."""
        return np.asarray(self.free + np.column_stack([self.x @ p, self.y @ p]))

    def normal_equations(self, p: Array, rows: _Rows, foot: Array, t: Array) -> tuple[Array, Array]:
        """H and g of ½pᵀHp + gᵀp, around p with the feet and directions (m, 2) found there.

        Of H, which is symmetric, only what is below the diagonal.
        """
        m = len(rows.path)
        at = self.free
        across = np.sqrt(rows.weight)
        along = np.sqrt(ALONG) * across
        x, y = self.x[:m], self.y[:m]
        tx, ty = t[:, X, None], t[:, Y, None]
        J = np.vstack([across[:, None] * (tx * y - ty * x), along[:, None] * (tx * x + ty * y)])
        off = at[:m] - foot
        r = np.concatenate(
            [
                across * (t[:, X] * off[:, Y] - t[:, Y] * off[:, X]),
                along * (t * (at[:m] - rows.path)).sum(axis=1),
            ]
        )
        H, g = dsyrk(1.0, J.T, lower=True), J.T @ r
        for of_p, free, place in (
            (self.x, at[:, X], rows.hold[X]),
            (self.y, at[:, Y], rows.hold[Y]),
        ):
            weighted = rows.holding[:, None] * of_p[m:]
            H += weighted.T @ of_p[m:]
            g += weighted.T @ (free[m:] - place)
        return H, g


@dataclass(frozen=True, slots=True)
class _Rows:
    """What is judged: path, direction (m, 2), weight (m,) of the samples around the hold.

    wide (m + …, 2): the path around each, of which ``window`` tells the rows; hold (2,): where
    the path stands; holding: weights of the rows in the hold.
    """

    path: Array
    direction: Array
    weight: Array
    candidates: Array
    hold: Array
    holding: Array

    @classmethod
    def of(cls, around: Surroundings, stop: Stop) -> _Rows:
        """Of that stop."""
        a, b = stop.a, stop.b
        index = np.concatenate([np.arange(a - BESIDE, a), np.arange(b, b + BESIDE + BEYOND)])
        weight = np.where(around.extruding[index], 1.0, TRAVELLING)
        weight[index >= stop.ends] = 0.0
        weight[: BESIDE - stop.before] = 0.0
        if not stop.after:
            weight[BESIDE:] = 0.0
        near = index[:, None] + np.arange(-NEAREST, NEAREST + 1)
        candidates = around.path[near]
        ahead = candidates[:, NEAREST + 1] - candidates[:, NEAREST]
        holding = np.full(len(_judged(b - a)), STANDING)
        if around.extruding[b : b + SOON].any():
            holding[-1:] = ARRIVING
        return cls(
            around.path[index], _unit(ahead, np.array([1.0, 0.0])), weight, candidates,
            around.path[a], holding,
        )  # fmt: skip

    def nearest(self, at: Array) -> tuple[Array, Array]:
        """The path's nearest points to the nozzle's places, and its directions there, (m, 2)."""
        x, y = self.candidates[..., X], self.candidates[..., Y]
        dx, dy = np.diff(x), np.diff(y)
        place = at[: len(self.path)]
        to_x, to_y = place[:, X, None] - x[:, :-1], place[:, Y, None] - y[:, :-1]
        along = (to_x * dx + to_y * dy) / np.maximum(dx * dx + dy * dy, 1e-18)
        along = np.clip(along, 0.0, 1.0)
        off_x, off_y = to_x - along * dx, to_y - along * dy
        best = (off_x * off_x + off_y * off_y).argmin(axis=1)
        row = np.arange(len(best))
        foot = place - np.column_stack([off_x[row, best], off_y[row, best]])
        step = np.column_stack([dx[row, best], dy[row, best]])
        return foot, _unit(step, self.direction)


def _judged(n: int) -> list[int]:
    """Samples of a hold of n that count: how far the nozzle swings, and where it is at last."""
    return [*range(STRIDE - 1, min(n, SWING) - 1, STRIDE), n - 1] if n else []


def _unit(vector: Array, otherwise: Array) -> Array:
    """Directions (m, 2); where there is none, another's."""
    length = np.hypot(vector[:, X], vector[:, Y])[:, None]
    return np.asarray(np.where(length > 1e-7, vector / np.maximum(length, 1e-7), otherwise))


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
