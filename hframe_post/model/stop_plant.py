"""The plant around a stop: its filters' states, and the nozzle by the command's splines.

The command next to a stop is the known one plus splines before the hold, a shift of the hold's own
place, and splines after it. Every filter is linear, so its output at the judged samples is a known
part plus a matrix times the weights ``p`` of these. Symbols are those of ``model.stop``.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from hframe_post.arrays import Array, Integers, X, Y
from hframe_post.model.plant import Plant
from hframe_post.model.stop_cost import (
    AFTER,
    BEFORE,
    BESIDE,
    BEYOND,
    Nozzle,
    Stop,
    Surroundings,
    judged_in_hold,
    judged_samples,
)
from hframe_post.model.transfer_function import BLOCK_SAMPLES, TransferFunction

State = tuple[Array, ...]  # of each filter, in the order of ``Filters``


class Filters:
    """The plant's transfer functions x, y and, where it racks, θ.

    N_before, N_after (BESIDE, k): the splines on either side of a hold.
    """

    def __init__(self, plant: Plant, N_before: Array, N_after: Array) -> None:
        self._x_c = plant.x_c
        racking = (plant.Gxtheta,) if plant.Gxtheta is not None else ()
        functions = (plant.Gxx, plant.Gyy, *racking)
        self._all = tuple(_Filter(G, N_before, N_after) for G in functions)
        self._inputs = (X, Y, X)[: len(self._all)]
        self.rest: State = tuple(np.zeros(G.order) for G in self._all)

    def at_rest(self, command: Array) -> State:
        """Return the state of a plant that has long stood at a command (2,)."""
        inputs = zip(self._all, self._inputs, strict=True)
        return tuple(G.equilibrium * command[i] for G, i in inputs)

    def after(self, z: State, command: Array) -> State:
        """Return the state after the next samples of the command (n, 2)."""
        inputs = zip(self._all, z, self._inputs, strict=True)
        return tuple(G.after(s, np.ascontiguousarray(command[:, i])) for G, s, i in inputs)

    def nozzle(
        self, around: Surroundings, command: Array, z: State, stop: Stop, columns: Integers
    ) -> Nozzle:
        """Return where the nozzle goes around a stop, by the splines in ``columns``.

        command (n, 2): of the surroundings, from the origin; z: state before sample a − BESIDE.
        """
        a, n = stop.a, stop.b - stop.a
        outputs = []
        for G, s, i in zip(self._all, z, self._inputs, strict=True):
            known = G.known(s, command[:, i], stop)
            outputs.append((G.by_splines(n)[:, columns], known))
        where = np.concatenate([judged_samples(stop), np.full(len(judged_in_hold(n)), a)])
        lever = around.path[where, X] + around.origin[X] - self._x_c
        return Nozzle.from_outputs(outputs, lever)


class _Filter:
    """One transfer function: its state, and its output at the judged samples (r,).

    These are the samples before the hold, after it, and in it. Matrices for the durations and
    block lengths that were asked last are kept.
    """

    def __init__(self, G: TransferFunction, N_before: Array, N_after: Array) -> None:
        self.order, self._lifted = G.order, lru_cache(maxsize=BLOCK_SAMPLES + 2)(G.lifted)
        self._A, B, self._C, self._D = G.state_space
        self.equilibrium = np.linalg.solve(np.eye(G.order) - self._A, B)
        self._standing = lru_cache(maxsize=128)(self._stand)
        self._held_output = lru_cache(maxsize=128)(self._output_in_hold)
        self.by_splines = lru_cache(maxsize=32)(self._output_by_splines)
        first, O, self._A_before, self._R = self._lifted(BESIDE)
        later, ringing, _, _ = self._lifted(BESIDE + BEYOND)
        self._G_before, self._O_before = first[BEFORE], O[BEFORE]
        self._G_after, self._O_after = later[AFTER], ringing[AFTER]
        self._before = self._G_before @ N_before
        self._after = self._G_after[:, :BESIDE] @ N_after
        self._reached = self._R @ N_before

    def after(self, s: Array, u: Array) -> Array:
        """Return the state that follows s after the input u (n,)."""
        blocks, rest = divmod(len(u), BLOCK_SAMPLES)
        whole = blocks * BLOCK_SAMPLES
        _, _, A, R = self._lifted(BLOCK_SAMPLES)
        # block by block, so that the bits do not depend on how many there are
        for reached in np.matmul(R, u[:whole].reshape(blocks, BLOCK_SAMPLES, 1))[..., 0]:
            s = A @ s + reached
        if rest:
            _, _, A, R = self._lifted(rest)
            s = A @ s + R @ u[whole:]
        return s

    def known(self, s: Array, u: Array, stop: Stop) -> Array:
        """Return the output (r,) under the input u of a stretch, from state s at a − BESIDE."""
        a, b, n = stop.a, stop.b, stop.b - stop.a
        before, h, after = u[a - BESIDE : a], u[a], u[b : b + BESIDE + BEYOND]
        state = self._A_before @ s + self._R @ before
        outputs = [self._G_before @ before + self._O_before @ s]
        ring, step = self._standing(n)
        outputs.append(self._G_after @ after + self._O_after @ (ring @ state + step * h))
        if n:
            by_state, by_input = self._held_output(n)
            outputs.append(by_state @ state + by_input * h)
        return np.concatenate(outputs)

    def _output_by_splines(self, n: int) -> Array:
        """Return the output (r, 2k + 1) by splines before, a hold of n, and splines after."""
        k = self._before.shape[1]
        until, around = len(BEFORE), len(BEFORE) + len(AFTER)
        state = np.zeros((self.order, 2 * k + 1))  # when the hold begins
        state[:, :k] = self._reached
        by_p = np.zeros((around + len(judged_in_hold(n)), 2 * k + 1))
        by_p[:until, :k] = self._before
        if n:
            by_state, by_input = self._held_output(n)
            by_p[around:] = by_state @ state
            by_p[around:, k] = by_input
        ring, step = self._standing(n)
        state = ring @ state
        state[:, k] = step
        by_p[until:around] = self._O_after @ state
        by_p[until:around, k + 1 :] += self._after
        return by_p

    def _stand(self, n: int) -> tuple[Array, Array]:
        """Return the state after n samples at an input h, as first @ state + second · h."""
        ring = np.linalg.matrix_power(self._A, n)
        return ring, self.equilibrium - ring @ self.equilibrium

    def _output_in_hold(self, n: int) -> tuple[Array, Array]:
        """Return the output in a hold of n: (r, d) by the state, (r,) by the input."""
        stood = [self._standing(samples) for samples in judged_in_hold(n)]
        by_state = np.array([self._C @ ring for ring, _ in stood]).reshape(len(stood), self.order)
        by_input = np.array([self._C @ step + self._D for _, step in stood])
        return by_state, by_input
