"""The linear plant of an H-frame printer, and the nozzle's response to a command.

The printer moves as (eq. 1, 2 and Fig. 2b of the paper)

    x = Gxx·x_d        θ = Gxθ·x_d        y = Gyy·y_d + (x − x_c)·θ
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import chain

import numpy as np

from hframe_post.arrays import Array, X, Y
from hframe_post.model.transfer_function import TransferFunction
from hframe_post.native import kernel


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


NO_RACKING = TransferFunction(np.zeros(0, complex), np.zeros(0, complex), 0.0)


class Filter:
    """A transfer function applied to a stream, its state carried: equal bits however it is cut."""

    def __init__(self, G: TransferFunction) -> None:
        self.sections = G.sections
        self.state = np.zeros((len(G.sections), 2))

    def run(self, u: Array) -> Array:
        """Return the output (n,) at the next samples of the input u (n,)."""
        if (compiled := kernel("filtered")) is not None:
            u, y = np.ascontiguousarray(u), np.empty(len(u))
            compiled(self.sections, len(self.sections), self.state, u, len(u), y)
            return y
        if not len(u):  # scipy takes no empty array
            return np.zeros(0)
        from scipy.signal import sosfilt  # takes long to import

        y, self.state = sosfilt(self.sections, u, zi=self.state)
        return np.asarray(y)


class Response:
    """The nozzle's motion under a command that comes in pieces, from rest at ``origin`` (2,)."""

    def __init__(self, plant: Plant, origin: Array) -> None:
        self._origin, self._x_c = origin, plant.x_c
        functions = plant.Gxx, plant.Gyy, plant.Gxtheta or NO_RACKING
        self.filters = tuple(Filter(G) for G in functions)

    def run(self, command: Array) -> Array:
        """Return the nozzle's x, y (n, 2) under the next samples of the command (n, 2)."""
        return self._motion(command, 2)

    def motion(self, command: Array) -> Array:
        """Return the nozzle's x, y and the gantry's θ, (n, 3), likewise: eq. 1 and 2."""
        return self._motion(command, 3)

    def _motion(self, command: Array, columns: int) -> Array:
        if (compiled := kernel("response")) is not None:
            command, motion = np.ascontiguousarray(command), np.empty((len(command), columns))
            filters = ((f.sections, len(f.sections), f.state) for f in self.filters)
            places = *self._origin.tolist(), self._x_c
            compiled(*chain(*filters), *places, command, len(command), motion, columns)
            return motion
        Gxx, Gyy, Gxtheta = self.filters
        u = command - self._origin
        x = Gxx.run(u[:, X]) + self._origin[X]
        theta = Gxtheta.run(u[:, X])
        y = Gyy.run(u[:, Y]) + self._origin[Y] + (x - self._x_c) * theta
        return np.column_stack([x, y, theta][:columns])
