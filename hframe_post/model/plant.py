"""The linear plant of an H-frame printer, and the nozzle's response to a command.

The printer moves as (eq. 1, 2 and Fig. 2b of the paper)

    x = Gxx·x_d        θ = Gxθ·x_d        y = Gyy·y_d + (x − x_c)·θ
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hframe_post.arrays import Array, X, Y, Z
from hframe_post.model.transfer_function import BLOCK_SAMPLES, TransferFunction


@dataclass(frozen=True)
class Plant:
    """The three transfer functions of Fig. 2(b); ``Gxtheta`` is None if the gantry does not rack.

    Gxtheta gives θ in rad per mm of x_d; x_c (mm) is the x coordinate at which racking
    does not move the nozzle.
    """

    Gxx: TransferFunction
    Gyy: TransferFunction
    Gxtheta: TransferFunction | None
    x_c: float


class LiftedFilter:
    """A transfer function applied to a stream, with its state carried: exact however it is cut.

    Cuts at multiples of ``BLOCK_SAMPLES`` also give equal bits.
    """

    def __init__(self, transfer_function: TransferFunction) -> None:
        self._G, self._O, self._recursion, self._R = transfer_function.block
        self._A = transfer_function.state_space[0]
        self._state = np.zeros(transfer_function.order)

    def run(self, u: Array) -> Array:
        """Return the output (n,) at the next samples of the input u (n,)."""
        blocks, rest = divmod(len(u), BLOCK_SAMPLES)
        U = np.zeros((blocks + (rest > 0), BLOCK_SAMPLES))
        U.ravel()[: len(u)] = u
        forced = U @ self._R.T
        states, self._state = self._recursion.run(forced[:blocks], self._state)
        if rest:  # part of a block
            states = np.vstack([states, self._state])
            before = np.linalg.matrix_power(self._A, rest) @ self._state
            self._state = before + self._R[:, BLOCK_SAMPLES - rest :] @ u[-rest:]
        Y = U @ self._G.T
        Y += states @ self._O.T
        return Y.ravel()[: len(u)]


class Response:
    """The nozzle's motion under a command that comes in pieces, from rest at ``origin`` (2,)."""

    def __init__(self, plant: Plant, origin: Array) -> None:
        self._origin, self._x_c = origin, plant.x_c
        self._Gxx, self._Gyy = LiftedFilter(plant.Gxx), LiftedFilter(plant.Gyy)
        self._Gxtheta = LiftedFilter(plant.Gxtheta) if plant.Gxtheta else None

    def run(self, command: Array) -> Array:
        """Return the nozzle's x, y (n, 2) under the next samples of the command (n, 2)."""
        return self.motion(command)[:, :Z]

    def motion(self, command: Array) -> Array:
        """Return the nozzle's x, y and the gantry's θ, (n, 3), likewise: eq. 1 and 2."""
        u = command - self._origin
        x = self._Gxx.run(u[:, X]) + self._origin[X]
        y = self._Gyy.run(u[:, Y]) + self._origin[Y]
        theta = np.zeros(len(u))
        if self._Gxtheta is not None:
            theta = self._Gxtheta.run(u[:, X])
            y += (x - self._x_c) * theta
        return np.column_stack([x, y, theta])
