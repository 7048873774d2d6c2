"""The plant's filters as a stop sees them: block by block, and while the command stands."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from hframe_post.arrays import Array, X, Y
from hframe_post.model.plant import Plant
from hframe_post.model.transfer_function import BLOCK_SAMPLES, TransferFunction

STRIDE, SWING = 4, 64  # samples between those of a hold, and how far into it
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


def judged(n: int) -> list[int]:
    """Samples of a hold of n that count: how far the nozzle swings, and where it is at last."""
    return [*range(STRIDE - 1, min(n, SWING) - 1, STRIDE), n - 1] if n else []
