"""The plant around a stop: its filters' states, and the nozzle by the command's splines.

The command next to a stop is the known one plus splines before the hold, a shift of the hold's own
place, and splines after it. Every filter is linear, so its output at the judged samples is a known
part plus a matrix times the weights ``p`` of these. Symbols are those of ``model.stop``.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np

from hframe_post.arrays import Array, X, Y
from hframe_post.model.linear import power, product, pseudo_inverse
from hframe_post.model.plant import Plant, Response
from hframe_post.model.stop_cost import AFTER, BEFORE, BESIDE, BEYOND, Stop, judged_in_hold
from hframe_post.model.transfer_function import TransferFunction

NO_RACKING = TransferFunction(np.zeros(0, complex), np.zeros(0, complex), 0.0)
State = tuple[Array, ...]  # of the filters x, y and θ, each (sections, 2)
INPUTS = X, Y, X  # of the command, to each filter


class Filters:
    """The plant's transfer functions x, y and θ.

    N_before, N_after (BESIDE, k): the splines on either side of a hold, in the order of time.
    """

    def __init__(self, plant: Plant, N_before: Array, N_after: Array) -> None:
        # stops know of racking only
        plant = replace(plant, Gxtheta=plant.Gxtheta or NO_RACKING, cross=())
        self._plant, self._N_before, self._N_after = plant, N_before, N_after
        functions = plant.Gxx, plant.Gyy, *(coupling.G for coupling in plant.couplings)
        self._all = tuple(_AroundHold(G) for G in functions)
        self.rest = self.at_rest(np.zeros(2))
        self.by_splines = lru_cache(maxsize=32)(self._by_splines)

    def at_rest(self, command: Array) -> State:
        """Return the state of a plant that has long stood at a command (2,)."""
        return tuple(
            (G.equilibrium * command[i]).reshape(-1, 2)
            for G, i in zip(self._all, INPUTS, strict=True)
        )

    def after(self, z: State, command: Array) -> State:
        """Return the state after the next samples of the command (n, 2)."""
        response = Response(self._plant, np.zeros(2))
        response.state[:] = np.concatenate(z)
        response.run(command)
        return tuple(np.split(response.state, np.cumsum([len(state) for state in z])[:-1]))

    def known(self, command: Array, z: State, stop: Stop, x: Array) -> tuple[Array, Array]:
        """Return the nozzle (r, 2) without p, and θ's lever arm (r,), at the judged samples.

        command (n, 2) from the origin; z: state before sample a − BESIDE; x (r,): of the path.
        """
        a, b = stop.a, stop.b
        (nozzle_x,), (nozzle_y,), (theta,) = (
            G.output(
                s.reshape(1, -1), command[None, a - BESIDE : a, i], command[None, a : a + 1, i],
                command[None, b : b + BESIDE + BEYOND, i], b - a,
            )
            for G, s, i in zip(self._all, z, INPUTS, strict=True)
        )  # fmt: skip
        lever = x - self._plant.x_c
        return np.column_stack([nozzle_x, nozzle_y + lever * theta]), lever

    def _by_splines(self, n: int) -> Array:
        """Return x, y and θ (3, r, 2k + 1) by splines before, a hold of n, and splines after."""
        k = self._N_before.shape[1]
        before, after = np.zeros((2 * k + 1, BESIDE)), np.zeros((2 * k + 1, BESIDE + BEYOND))
        before[:k], after[k + 1 :, :BESIDE] = self._N_before.T, self._N_after.T
        h = np.zeros((2 * k + 1, 1))
        h[k] = 1.0
        outputs = [
            G.output(np.zeros((2 * k + 1, G.order)), before, h, after, n).T for G in self._all
        ]
        return np.stack(outputs)


class _AroundHold:
    """One transfer function around a hold: its output at the judged samples, in order of time.

    Its matrices take row vectors: a state and inputs.
    """

    def __init__(self, G: TransferFunction) -> None:
        self._A, B, self._C, self._D = G.state_space
        self.order = len(B)
        still = pseudo_inverse(np.eye(self.order) - self._A, np.inf)
        assert still is not None  # a stable function comes to rest
        self.equilibrium = product(B, still.T)
        first, O, A, R = G.lifted(BESIDE)
        later, ringing, _, _ = G.lifted(BESIDE + BEYOND)
        self._before = np.block([[O[BEFORE].T, A.T], [first[BEFORE].T, R.T]])
        self._after = np.vstack([ringing[AFTER].T, later[AFTER].T])
        self._hold = lru_cache(maxsize=128)(self._in_hold)

    def output(self, s: Array, before: Array, h: Array, after: Array, n: int) -> Array:
        """Return the outputs (m, r) of m inputs at once.

        s (m, d): states before; before (m, BESIDE), after (m, BESIDE + BEYOND): inputs on either
        side of a hold of n samples at h (m, 1).
        """
        until, s = _cut(product(np.hstack([s, before]), self._before), len(BEFORE))
        held, s = _cut(product(np.hstack([s, h]), self._hold(n)), len(judged_in_hold(n)))
        return np.hstack([until, held, product(np.hstack([s, after]), self._after)])

    def _in_hold(self, n: int) -> Array:
        """Return the matrix (d + 1, h + d) from state and input to h outputs and the next state."""
        outputs = [product(self._C, self._stand(samples)) for samples in judged_in_hold(n)]
        held = np.array(outputs).reshape(-1, self.order + 1)
        held[:, -1] += self._D
        return np.vstack([held, self._stand(n)]).T

    def _stand(self, n: int) -> Array:
        """Return the state (d, d + 1) after n samples, by the state before and by the input."""
        ring = power(self._A, n)
        step = self.equilibrium - product(self.equilibrium, ring.T)
        return np.column_stack([ring, step])


def _cut(rows: Array, n: int) -> tuple[Array, Array]:
    return rows[:, :n], rows[:, n:]
