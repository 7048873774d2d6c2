"""The nozzle's motion under a command that comes in pieces: its axes, and racking."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hframe_post.arrays import Array, X, Y, moved
from hframe_post.model.impulse_response import FiniteFilter
from hframe_post.model.plant import Plant


class Response:
    """The nozzle's motion under a command that comes in pieces, from rest at ``origin`` (2,).

    late: samples by which the motion comes later than the command, at least and by default the
    plant's ``ahead``. single: in single precision.
    """

    def __init__(
        self, plant: Plant, origin: Array, late: int | None = None, single: bool = False
    ) -> None:
        self.late = plant.ahead if late is None else late
        self._racking, self._origin = plant.racking, origin
        self._filters = [FiniteFilter(G, self.late, single) for G in plant.responses]

    def run(self, command: Array, out: Array | None = None) -> Array:
        """Return the nozzle's x, y (n, 2) at samples that lag behind those of command (n, 2).

        It is in ``out``, if given.
        """
        return self.motion(command, out)[0]

    def motion(self, command: Array, out: Array | None = None) -> tuple[Array, Array]:
        """Return what ``run`` does, and θ (n,) there, rad."""
        u = np.subtract(command.T, self._origin[:, None], order="C")
        axes = (X, Y, X)[: len(self._filters)]
        x, y, *theta = (f.run(u[axis]) for f, axis in zip(self._filters, axes, strict=True))
        place = moved((x, y), self._origin, out)
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


# ----------------------------------------------------------------------
# The nozzles of several plants under one or several commands that come in pieces.


class Plants:
    """Plants that get the same commands."""

    def __init__(self, each: Sequence[Plant]) -> None:
        self._each = tuple(each)
        self._loads, self._loaded = list[int](), self._each

    def __len__(self) -> int:
        return len(self._each)

    def at_rest(self, origin: Array, commands: int, filament: float) -> Responses:
        """Return responses that begin at rest at ``origin`` (2,), with filament (mm) on the bed.

        commands: how many each plant gets.
        """
        loads = [plant.load(filament) for plant in self._each]
        if loads != self._loads:
            self._loads, self._loaded = loads, tuple(map(Plant.loaded, self._each, loads))
        return Responses(self._loaded, origin, commands)


class Responses:
    """Nozzles of plants from rest at ``origin`` (2,), under as many commands.

    late: samples by which the nozzles' motion comes later than the commands.
    """

    def __init__(self, plants: Sequence[Plant], origin: Array, commands: int) -> None:
        self.late = max(plant.ahead for plant in plants)
        self._each = [
            [Response(plant, origin, self.late, single=True) for _ in range(commands)]
            for plant in plants
        ]

    def run(self, commands: Sequence[Array]) -> Array:
        """Return the nozzles' x, y (plants, commands, n, 2) under the next samples, (n, 2) each."""
        motion = np.empty((len(self._each), len(commands), len(commands[0]), 2))
        for responses, of_plant in zip(self._each, motion, strict=True):
            for response, command, out in zip(responses, commands, of_plant, strict=True):
                response.run(command, out)
        return motion
