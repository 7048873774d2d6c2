"""The plant around a stop: the nozzle by the known command, and by the command's splines.

The command next to a stop is the known one plus splines before the dwell, a shift of the dwell's
own place, and splines after it. Every filter is linear, so its output at the judged samples is a
known part plus a matrix times the weights ``p`` of these. Symbols are those of ``model.stop``.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from hframe_post.arrays import Array, Integers, X, Y
from hframe_post.model.filters import FiniteFilter, stream_filter
from hframe_post.model.plant import Plant
from hframe_post.model.stop_cost import BESIDE, BEYOND, judged


class AroundStops:
    """The plant's motion around stops.

    N_before, N_after (BESIDE, k): the splines on either side of a dwell, in the order of time.
    axes (couplings, 2): where each coupling responds, and the command. ahead, memory: samples of
    the command after a sample, and before it, that the nozzle's place depends on.
    """

    def __init__(self, plant: Plant, N_before: Array, N_after: Array) -> None:
        self._plant, self._N_before, self._N_after = plant, N_before, N_after
        self.ahead = plant.ahead
        self._filters = self._filters_of(plant)
        self.memory = max(f.memory for f in self._filters)
        self._couplings = plant.couplings
        self._places = np.array(plant.places)
        axes = [(coupling.answer, coupling.command) for coupling in plant.couplings]
        self.axes: Integers = np.array(axes, np.int64).reshape(-1, 2)
        self.by_splines = lru_cache(maxsize=32)(self._by_splines)

    def _filters_of(self, plant: Plant) -> list[FiniteFilter]:
        functions = plant.Gxx, plant.Gyy, *(c.G for c in plant.couplings)
        return [stream_filter(G, self.ahead) for G in functions]

    def known(self, command: Array, path: Array, n: int, x: float) -> tuple[Array, Array]:
        """Return the nozzle (r, 2) without p, and lever arms (couplings, r), at the judged samples.

        command: from ``memory`` + BESIDE samples before a dwell of n samples to BESIDE + BEYOND +
        ahead after it, from an origin at x, mm; path (r, 2): on the bed, at the judged samples.
        """
        u, at, couplings = np.ascontiguousarray(command.T), judged(n) + self.ahead, self._couplings
        place = u[X, self.memory - self.ahead : len(command) - self.ahead] + x
        axes = X, Y, *(coupling.command for coupling in couplings)
        outputs = [
            f.output(u[axis], place)[at] for f, axis in zip(self._filters, axes, strict=True)
        ]
        nozzle, levers = np.stack(outputs[:2], axis=1), np.ones((len(couplings), len(at)))
        for coupling, output, lever in zip(couplings, outputs[2:], levers, strict=True):
            lever[:] = coupling.lever(path)
            nozzle[:, coupling.answer] += lever * output
        return nozzle, levers

    def node(self, x: float) -> int:
        """Return the number of the place near x (mm) for which matrices are computed."""
        return int(np.argmin(np.abs(self._places - x)))

    def _by_splines(self, n: int, node: int) -> Array:
        """Return the filters' outputs (2 + couplings, r, 2k + 1) by splines and by a dwell of n."""
        plant = self._plant.at(float(self._places[node])) if self._plant.along_x else self._plant
        k, end = self._N_before.shape[1], BESIDE + n
        commands = np.zeros((2 * k + 1, end + BESIDE + BEYOND + self.ahead))
        commands[:k, :BESIDE] = self._N_before.T
        commands[k, BESIDE:end] = 1.0
        commands[k + 1 :, end : end + BESIDE] = self._N_after.T
        filters = self._filters_of(plant)
        outputs = np.zeros((len(filters), 2 * k + 1, len(judged(n))))
        for f, of_filter in zip(filters, outputs, strict=True):
            for command, output in zip(commands, of_filter, strict=True):
                known = np.pad(command, (f.memory, 0))
                output[:] = f.output(known, command)[judged(n) + self.ahead]
        return outputs.transpose(0, 2, 1)
