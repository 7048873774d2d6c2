"""The nozzles of several plants under one or several commands that come in pieces."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hframe_post.arrays import Array
from hframe_post.model.nozzle import Response
from hframe_post.model.plant import Plant


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
            [Response(plant, origin, self.late) for _ in range(commands)] for plant in plants
        ]

    def run(self, commands: Sequence[Array]) -> Array:
        """Return the nozzles' x, y (plants, commands, n, 2) under the next samples, (n, 2) each."""
        motion = np.empty((len(self._each), len(commands), len(commands[0]), 2))
        for responses, of_plant in zip(self._each, motion, strict=True):
            for response, command, out in zip(responses, commands, of_plant, strict=True):
                response.run(command, out)
        return motion
