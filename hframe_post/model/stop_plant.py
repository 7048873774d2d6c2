"""The plant around a stop: the nozzle by the known command, and by the command's splines.

The command next to a stop is the known one plus splines before the dwell, a shift of the dwell's
own place, and splines after it. Every filter is linear, so its output at the judged samples is a
known part plus a matrix times the weights ``p`` of these. Symbols are those of ``model.stop``.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from hframe_post.arrays import Array, Integers, X
from hframe_post.model.filters import stream_filter
from hframe_post.model.nozzle import Response
from hframe_post.model.plant import Plant
from hframe_post.model.stop_cost import BESIDE, BEYOND, judged


class AroundStops:
    """The plant's motion around stops.

    N_before, N_after (BESIDE, k): the splines on either side of a dwell, in the order of time.
    axes (couplings, 2): where each coupling responds, and the command. ahead: samples of the
    command after a sample that the nozzle's place depends on.
    """

    def __init__(self, plant: Plant, N_before: Array, N_after: Array) -> None:
        self._plant, self._N_before, self._N_after = plant, N_before, N_after
        self.ahead = plant.ahead
        self._places = np.array(plant.places)
        axes = [(coupling.answer, coupling.command) for coupling in plant.couplings]
        self.axes: Integers = np.array(axes, np.int64).reshape(-1, 2)
        self.by_splines = lru_cache(maxsize=32)(self._by_splines)

    def at_rest(self, command: Array, origin: Array) -> Response:
        """Return the response, ``ahead`` samples late, after a long rest at a command (2,).

        Commands and motion are counted from the origin (2,), mm.
        """
        response = Response(self._plant, np.zeros(2), away=float(origin[X]))
        response.settle(command)
        return response

    def known(self, before: Response, command: Array, path: Array, n: int) -> tuple[Array, Array]:
        """Return the nozzle (r, 2) without p, and lever arms (couplings, r), at the judged samples.

        before: the response to all earlier commands; command: from BESIDE samples before a dwell of
        n samples to BESIDE + BEYOND + ahead after it; path (r, 2): at the judged samples.
        """
        at, outputs = (each[judged(n) + self.ahead] for each in before.imagined(command))
        nozzle, levers = at.copy(), np.ones((len(self.axes), len(at)))
        for coupling, output, lever in zip(self._plant.couplings, outputs.T, levers, strict=True):
            if coupling.along is not None:
                off = path[:, coupling.along] - at[:, coupling.along]
                nozzle[:, coupling.answer] += off * output
                lever[:] = coupling.lever(path)
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
        functions = plant.Gxx, plant.Gyy, *(c.G for c in plant.couplings)
        filters = [stream_filter(G, self.ahead) for G in functions]
        outputs = np.zeros((len(filters), 2 * k + 1, len(judged(n))))
        for f, of_filter in zip(filters, outputs, strict=True):
            for command, output in zip(commands, of_filter, strict=True):
                f.state[:] = 0.0
                output[:] = f.run(command)[judged(n) + self.ahead]
        return outputs.transpose(0, 2, 1)
