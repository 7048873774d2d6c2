"""The nozzles of several similar plants under one or several commands, found side by side.

A filter waits for its last output at each sample. So a processor computes four plants, or the
responses to four commands, in little more than the time of one.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from hframe_post.arrays import Array
from hframe_post.model.nozzle import Filters, Response
from hframe_post.model.plant import Plant
from hframe_post.native import plant as native
from hframe_post.native.plant import LANES, Couplings, Sections


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
            couplings = [each.couplings for each in filters]
            fused = _alike(filters)
            self._lanes = _Lanes(fused, couplings, commands) if fused else None
        if self._lanes is not None:
            return _SideBySide(self._lanes, origin)
        return _OneByOne(self._loaded, origin, commands)


def _alike(filters: Sequence[Filters]) -> list[Sections]:
    """Return the sections of fused filters that differ in coefficients and lever arms only."""
    fused, first = [f.fused for f in filters if f.fused is not None], filters[0]
    alike = len(fused) == len(filters) and all(
        np.array_equal(sections.counts, fused[0].counts)
        and np.array_equal(other.couplings.axes, first.couplings.axes)
        for sections, other in zip(fused, filters, strict=True)
    )
    return fused if alike else []


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
    """A lane for each plant and command, in groups of LANES; the last group repeats some.

    table, couplings: as ``native.plant.responses`` takes them; which (lanes,): the number of each
    lane's command.
    """

    def __init__(
        self, fused: Sequence[Sections], couplings: Sequence[Couplings], commands: int
    ) -> None:
        self.shape, self.counts = (len(fused), commands), fused[0].counts
        lanes = len(fused) * commands
        lane = np.arange(-(-lanes // LANES) * LANES) % lanes
        plant = (lane // commands).reshape(-1, LANES)
        self.which = lane[:lanes] % commands
        self.table, centres = (
            np.ascontiguousarray(np.moveaxis(np.stack(arrays)[plant], 1, -1))
            for arrays in ([each.table for each in fused], [each.centres for each in couplings])
        )
        self.couplings = Couplings(couplings[0].axes, centres)


class _SideBySide:
    late = 0  # fused filters never are

    def __init__(self, lanes: _Lanes, origin: Array) -> None:
        self._lanes, self._origin = lanes, np.ascontiguousarray(origin)
        groups, sections, _, _ = lanes.table.shape
        state = np.zeros((groups, sections, 2, LANES))
        self._filters = Sections(lanes.table, state, lanes.counts)

    def run(self, commands: Sequence[Array]) -> Array:
        lanes, together = self._lanes, np.array(commands)
        motion = native.responses(
            self._filters, lanes.couplings, self._origin, together, lanes.which
        )
        return motion.reshape(*lanes.shape, -1, 2)
