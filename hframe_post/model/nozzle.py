"""The nozzle's motion under a command that comes in pieces: axes and couplings side by side."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hframe_post.arrays import Array, X, Y
from hframe_post.model.filters import FiniteFilter, stream_filter
from hframe_post.model.impulse_response import ImpulseResponse
from hframe_post.model.plant import Coupling, Plant
from hframe_post.native import judging as native
from hframe_post.native.judging import Couplings, sum_of

STIFF = ImpulseResponse(np.zeros(1), 0)


class Filters:
    """Filters side by side, each ``late`` samples late; ``along_x``: whether one changes along x.

    couplings: the last filters'.
    """

    def __init__(
        self, direct: Sequence[ImpulseResponse], couplings: Sequence[Coupling], late: int
    ) -> None:
        functions = (*direct, *(coupling.G for coupling in couplings))
        self.each = [stream_filter(G, late) for G in functions]
        self.late, self.along_x = late, any(G.elsewhere for G in functions)
        axes = [(c.answer, c.command, -1 if c.along is None else c.along) for c in couplings]
        centres = np.array([coupling.centre for coupling in couplings])
        self.couplings = Couplings(np.array(axes, np.int64).reshape(-1, 3), centres)

    @classmethod
    def of_plant(cls, plant: Plant, late: int) -> Filters:
        return cls((plant.Gxx, plant.Gyy), plant.couplings, late)

    @property
    def commands(self) -> list[int]:
        """Return the axis of the command of each coupling."""
        commands: list[int] = self.couplings.axes[:, 1].tolist()
        return commands


class Coupled:
    """What couplings add to the nozzle in one axis, under commands that come in pieces.

    late: samples by which the result comes later than the commands.
    """

    def __init__(self, couplings: Sequence[Coupling], origin: Array) -> None:
        self.late = max(coupling.G.ahead for coupling in couplings)
        self._filters, self._origin = Filters((), couplings, self.late), origin

    def run(self, path: Array, x_dm: Array, y_dm: Array) -> Array:
        """Return the sum (n,) at samples of the path (n, 2), which lag behind the commands (n,).

        All are relative to the origin. The lever arms are those of the path.
        """
        filters, couplings, commands = self._filters, self._filters.couplings, (x_dm, y_dm)
        place = path + self._origin
        outputs = [
            G.run(commands[axis], place[:, X])
            for G, axis in zip(filters.each, filters.commands, strict=True)
        ]
        return sum_of(outputs, couplings, place)


class Response:
    """The nozzle's motion under a command that comes in pieces, from rest at ``origin`` (2,).

    late: samples by which the motion comes later than the command, at least and by default the
    plant's ``ahead``.
    """

    def __init__(self, plant: Plant, origin: Array, late: int | None = None) -> None:
        self.late = plant.ahead if late is None else late
        self._filters = Filters.of_plant(plant, self.late)
        self._origin = origin
        # where responses change along x, the command tells x: the nozzle is within half a mm of it
        self._x = FiniteFilter(STIFF, self.late) if self._filters.along_x else None
        self._from_x = float(origin[X])

    def run(self, command: Array, out: Array | None = None) -> Array:
        """Return the nozzle's x, y (n, 2) at samples that lag behind those of command (n, 2).

        It is in ``out``, if given.
        """
        return self._motion(command, np.empty((len(command), 2)) if out is None else out)

    def motion(self, command: Array) -> tuple[Array, Array]:
        """Return the nozzle's x, y (n, 2), and what each coupling's G gives, (n, couplings)."""
        both = self._motion(command, np.empty((len(command), len(self._filters.each))))
        return both[:, :2], both[:, 2:]

    def _motion(self, command: Array, motion: Array) -> Array:
        filters, couplings = self._filters, self._filters.couplings
        u = np.subtract(command.T, self._origin[:, None], order="C")
        x = u[X] if self._x is None else self._x.run(u[X]) + self._from_x
        axes = X, Y, *filters.commands
        outputs = [f.run(u[axis], x) for f, axis in zip(filters.each, axes, strict=True)]
        return native.nozzle(outputs, couplings, self._origin, motion)


def nozzle(plant: Plant, origin: Array, command: Array) -> Array:
    """Return the nozzle's x, y (n, 2) under a whole command (n, 2).

    The plant rests at ``origin`` (2,) before it, and the command rests after it.
    """
    return motion(plant, origin, command)[0]


def motion(plant: Plant, origin: Array, command: Array) -> tuple[Array, Array]:
    """Return what ``nozzle`` does, and what each coupling's G gives, (n, couplings)."""
    response = Response(plant, origin)
    following = np.pad(command, ((0, response.late), (0, 0)), mode="edge")
    place, outputs = response.motion(following)
    return place[response.late :], outputs[response.late :]


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
            [Response(plant, origin, self.late) for _ in range(commands)] for plant in plants
        ]

    def run(self, commands: Sequence[Array]) -> Array:
        """Return the nozzles' x, y (plants, commands, n, 2) under the next samples, (n, 2) each."""
        motion = np.empty((len(self._each), len(commands), len(commands[0]), 2))
        for responses, of_plant in zip(self._each, motion, strict=True):
            for response, command, out in zip(responses, commands, of_plant, strict=True):
                response.run(command, out)
        return motion
