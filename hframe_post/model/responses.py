"""The nozzles of several similar plants under one or several commands, found side by side.

A filter waits for its last output at each sample. So a processor computes four plants, or the
responses to four commands, in little more than the time of one.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from hframe_post.arrays import Array
from hframe_post.model.plant import Filters, Plant, Response
from hframe_post.native import Kernel, kernel

WIDTH = 4  # lanes that the compiled loop takes together


class Responses(Protocol):
    """Nozzles under commands that come in pieces.

    late: samples by which the nozzles' motion comes later than the commands.
    """

    @property
    def late(self) -> int: ...

    def run(self, commands: Sequence[Array]) -> Array:
        """Return the nozzles' x, y (plants, commands, n, 2) under the next samples, (n, 2) each."""


class Plants:
    """Plants that get the same commands."""

    def __init__(self, each: Sequence[Plant]) -> None:
        self._each = tuple(each)
        self._key: tuple[int, ...] = ()
        self._loaded = self._each
        self._lanes: _Lanes | None = None

    def __len__(self) -> int:
        return len(self._each)

    def at_rest(self, origin: Array, commands: int, filament: float) -> Responses:
        """Return responses that begin at rest at ``origin`` (2,), with filament (mm) on the bed.

        commands: how many each plant gets.
        """
        loads = [plant.load(filament) for plant in self._each]
        if self._key != (key := (commands, *loads)):
            self._key, self._loaded = key, tuple(map(Plant.loaded, self._each, loads))
            late = max(plant.ahead for plant in self._loaded)
            filters = [Filters.of_plant(plant, late) for plant in self._loaded]
            self._lanes = _Lanes(filters, commands) if _alike(filters) else None
        if (compiled := kernel("responses")) is not None and self._lanes is not None:
            return _SideBySide(self._lanes, origin, compiled)
        return _OneByOne(self._loaded, origin, commands)


def _alike(filters: Sequence[Filters]) -> bool:
    """Return whether they differ in coefficients and lever arms only, and are fused."""
    first = filters[0]
    return all(f.fused for f in filters) and all(
        np.array_equal(other.counts, first.counts) and np.array_equal(other.axes, first.axes)
        for other in filters
    )


class _OneByOne:
    def __init__(self, plants: Sequence[Plant], origin: Array, commands: int) -> None:
        self.late = max(plant.ahead for plant in plants)
        self._each = [
            [Response(plant, origin, self.late) for _ in range(commands)] for plant in plants
        ]

    def run(self, commands: Sequence[Array]) -> Array:
        motion = np.empty((len(self._each), len(commands), len(commands[0]), 2))
        for responses, of_plant in zip(self._each, motion, strict=True):
            for response, command, out in zip(responses, commands, of_plant, strict=True):
                response.run(command, out)
        return motion


class _Lanes:
    """A lane for each plant and command, in groups of WIDTH; the last group repeats some.

    The loop's arguments: sections (groups, k, 6, WIDTH), centres (groups, couplings, WIDTH), and
    command (lanes,), the number of each lane's command.
    """

    def __init__(self, filters: Sequence[Filters], commands: int) -> None:
        self.like, self.shape = filters[0], (len(filters), commands)
        lanes = len(filters) * commands
        lane = np.arange(-(-lanes // WIDTH) * WIDTH) % lanes
        plant = (lane // commands).reshape(-1, WIDTH)
        self.command = lane[:lanes] % commands
        self.sections, self.centres = (
            np.ascontiguousarray(np.moveaxis(np.stack(tables)[plant], 1, -1))
            for tables in ([f.sections for f in filters], [f.centres for f in filters])
        )


class _SideBySide:
    late = 0  # fused filters never are

    def __init__(self, lanes: _Lanes, origin: Array, compiled: Kernel) -> None:
        self._lanes, self._origin, self._compiled = lanes, np.ascontiguousarray(origin), compiled
        groups, sections, _, _ = lanes.sections.shape
        self._state = np.zeros((groups, sections, 2, WIDTH))

    def run(self, commands: Sequence[Array]) -> Array:
        lanes, like, n = self._lanes, self._lanes.like, len(commands[0])
        motion = np.empty((*lanes.shape, n, 2))
        self._compiled(
            lanes.sections, len(like.sections), self._state, like.counts, len(like.counts),
            like.axes, lanes.centres, len(like.axes), self._origin, np.array(commands),
            len(commands), lanes.command, n, len(lanes.command), motion,
        )  # fmt: skip
        return motion
