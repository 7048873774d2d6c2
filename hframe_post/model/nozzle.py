"""The nozzle's motion under a command: its axes, and racking."""

from __future__ import annotations

import numpy as np

from hframe_post.arrays import Array, X, Y, moved
from hframe_post.model.impulse_response import CoarseFilter, FiniteFilter
from hframe_post.model.plant import Plant


class Response:
    """The nozzle's motion under a command that comes in pieces, from rest at ``origin`` (2,).

    late: samples by which the motion comes later than the command.
    """

    def __init__(self, plant: Plant, origin: Array) -> None:
        self.late, self._racking, self._origin = plant.ahead, plant.racking, origin
        self._filters = [FiniteFilter(G, self.late) for G in plant.responses]

    def run(self, command: Array) -> Array:
        """Return the nozzle's x, y (n, 2) at samples that lag behind those of command (n, 2)."""
        return self.motion(command)[0]

    def motion(self, command: Array) -> tuple[Array, Array]:
        """Return what ``run`` does, and θ (n,) there, rad."""
        u = np.subtract(command.T, self._origin[:, None], order="C")
        axes = (X, Y, X)[: len(self._filters)]
        x, y, *theta = (f.run(u[axis]) for f, axis in zip(self._filters, axes, strict=True))
        place = moved((x, y), self._origin)
        if not self._racking:
            return place, np.zeros(len(place))
        place[:, Y] += self._racking.lever(place) * theta[0]
        return place, theta[0]


def nozzle(plant: Plant, origin: Array, command: Array) -> Array:
    """Return the nozzle's x, y (n, 2) under a whole command (n, 2).

    The plant rests at ``origin`` (2,) before it, and the command rests after it.
    """
    response = Response(plant, origin)
    following = np.pad(command, ((0, response.late), (0, 0)), mode="edge")
    return response.run(following)[response.late :]


class Nozzle:
    """A plant's nozzle in pieces of commands, at half the rate.

    past, ahead: samples of a command that a piece needs before it and after it.
    """

    def __init__(self, plant: Plant) -> None:
        self._racking = plant.racking
        self._filters = [CoarseFilter(G) for G in plant.responses]
        self.past = max(f.past for f in self._filters)
        self.ahead = max(f.ahead for f in self._filters)

    def at(self, command: Array, n: int, every: int) -> Array:
        """Return the nozzle's x, y at every n-th (``every``) of n samples.

        command (past + n + ahead, 2).
        """
        u = np.ascontiguousarray(command.T)
        axes = (X, Y, X)[: len(self._filters)]
        found = zip(self._filters, axes, strict=True)
        x, y, *theta = (f.output(u[axis], self.past, n, every) for f, axis in found)
        place = np.column_stack([x, y])
        if self._racking:
            place[:, Y] += self._racking.lever(place) * theta[0]
        return place
