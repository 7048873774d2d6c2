"""The plant's filters as a stop sees them: block by block, and while the command stands."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from hframe_post.arrays import Array, X, Y
from hframe_post.model.plant import Plant
from hframe_post.model.stop_cost import AFTER, BEFORE, BESIDE, BEYOND, judged
from hframe_post.model.transfer_function import BLOCK_SAMPLES, TransferFunction

DURATIONS = 128  # of holds, that are remembered

State = tuple[Array, ...]


class Filters:
    """The plant's transfer functions with their states: x, y and, where it racks, θ."""

    def __init__(self, plant: Plant) -> None:
        self.x_c = plant.x_c
        racks = (plant.Gxtheta,) if plant.Gxtheta is not None else ()
        self.all = tuple(Lifted(G) for G in (plant.Gxx, plant.Gyy, *racks))
        self.inputs = (X, Y, X)[: len(self.all)]
        self.rest: State = tuple(np.zeros(G.order) for G in self.all)

    def at_rest(self, command: Array) -> State:
        """The states of a plant that has long stood at a command (2,)."""
        return tuple(G.equilibrium * command[i] for G, i in zip(self.all, self.inputs, strict=True))

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


class Lifted:
    """One transfer function over blocks of samples, and while its input stands (remembered)."""

    def __init__(self, G: TransferFunction) -> None:
        self.order, self.lifted = G.order, lru_cache(maxsize=BLOCK_SAMPLES + 2)(G.lifted)
        self._A, B, self._C, self._D = G.state_space
        self.equilibrium = np.linalg.solve(np.eye(G.order) - self._A, B)
        self.standing = lru_cache(maxsize=DURATIONS)(self._stood)
        self.held_output = lru_cache(maxsize=DURATIONS)(self._held_output)

    def _stood(self, n: int) -> tuple[Array, Array]:
        """State after n samples at an input h: first @ state + second · h."""
        ring = np.linalg.matrix_power(self._A, n)
        return ring, self.equilibrium - ring @ self.equilibrium

    def _held_output(self, n: int) -> tuple[Array, Array]:
        """Output at the judged samples of a hold of n: (r, d) by the state, (r,) by the input."""
        stood = [self.standing(samples) for samples in judged(n)]
        by_state = np.array([self._C @ ring for ring, _ in stood]).reshape(len(stood), self.order)
        by_input = np.array([self._C @ step + self._D for _, step in stood])
        return by_state, by_input


class Response:
    """Outputs at the judged samples (r,): before the hold, after it, and in it.

    N_before, N_after (BESIDE, k): the splines beside the hold, whose own place is one more.
    """

    def __init__(self, G: Lifted, N_before: Array, N_after: Array) -> None:
        self._G = G
        first, O, self._A, self._R = G.lifted(BESIDE)
        later, ringing, _, _ = G.lifted(BESIDE + BEYOND)
        self._G_before, self._O_before = first[BEFORE], O[BEFORE]
        self._G_after, self._O_after = later[AFTER], ringing[AFTER]
        self._before = self._G_before @ N_before
        self._after = self._G_after[:, :BESIDE] @ N_after
        self._reached = self._R @ N_before
        self.by_splines = lru_cache(maxsize=32)(self._by_splines)

    def _by_splines(self, n: int) -> Array:
        """Outputs (r, 2k + 1) by splines before, hold and splines after, of a hold of n."""
        k = self._before.shape[1]
        until, around = len(BEFORE), len(BEFORE) + len(AFTER)
        state = np.zeros((len(self._A), 2 * k + 1))  # when the hold begins
        state[:, :k] = self._reached
        by_p = np.zeros((around + len(judged(n)), 2 * k + 1))
        by_p[:until, :k] = self._before
        if n:
            by_state, by_input = self._G.held_output(n)
            by_p[around:] = by_state @ state
            by_p[around:, k] = by_input
        ring, step = self._G.standing(n)
        state = ring @ state
        state[:, k] = step
        by_p[until:around] = self._O_after @ state
        by_p[until:around, k + 1 :] += self._after
        return by_p

    def known(self, s: Array, before: Array, h: float, after: Array, n: int) -> Array:
        """Outputs (r,) from state s by the inputs before, in and after a hold of n samples at h."""
        state = self._A @ s + self._R @ before
        outputs = [self._G_before @ before + self._O_before @ s]
        ring, step = self._G.standing(n)
        outputs.append(self._G_after @ after + self._O_after @ (ring @ state + step * h))
        if n:
            by_state, by_input = self._G.held_output(n)
            outputs.append(by_state @ state + by_input * h)
        return np.concatenate(outputs)
