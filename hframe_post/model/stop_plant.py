"""The plant around a stop: the nozzle by the known command, and by the command's splines.

The command next to a stop is the known one plus splines before the hold, a shift of the hold's own
place, and splines after it. Every filter is linear, so its output at the judged samples is a known
part plus a matrix times the weights ``p`` of these. Symbols are those of ``model.stop``.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np

from hframe_post.arrays import Array, X, Y
from hframe_post.model.plant import Filter, Plant, Response
from hframe_post.model.stop_cost import BESIDE, BEYOND, judged
from hframe_post.model.transfer_function import TransferFunction

NO_RACKING = TransferFunction(np.zeros(0, complex), np.zeros(0, complex), 0.0)


class AroundStops:
    """The plant's motion around stops.

    N_before, N_after (BESIDE, k): the splines on either side of a hold, in the order of time.
    """

    def __init__(self, plant: Plant, N_before: Array, N_after: Array) -> None:
        # stops know of racking only
        self._plant = replace(plant, Gxtheta=plant.Gxtheta or NO_RACKING, cross=())
        self._N_before, self._N_after = N_before, N_after
        self.by_splines = lru_cache(maxsize=32)(self._by_splines)

    def at_rest(self, command: Array) -> Response:
        """Return the response of a plant that has long stood at a command (2,)."""
        response = Response(self._plant, np.zeros(2))
        response.settle(command)
        return response

    def known(self, before: Response, command: Array, x: Array, n: int) -> tuple[Array, Array]:
        """Return the nozzle (r, 2) without p, and θ's lever arm (r,), at the judged samples.

        before: the response to all earlier commands; command: from BESIDE samples before a hold of
        n samples to BESIDE + BEYOND after it; x (r,): of the path.
        """
        state = before.state.copy()
        nozzle, theta = (each[judged(n)] for each in before.motion(command))
        before.state[:] = state
        nozzle[:, Y] += (x - nozzle[:, X]) * theta[:, 0]
        return nozzle, x - self._plant.x_c

    def _by_splines(self, n: int) -> Array:
        """Return x, y and θ (3, r, 2k + 1) by splines before, a hold of n, and splines after."""
        k, end = self._N_before.shape[1], BESIDE + n
        commands = np.zeros((2 * k + 1, end + BESIDE + BEYOND))
        commands[:k, :BESIDE] = self._N_before.T
        commands[k, BESIDE:end] = 1.0
        commands[k + 1 :, end : end + BESIDE] = self._N_after.T
        functions = self._plant.Gxx, self._plant.Gyy, *(c.G for c in self._plant.couplings)
        outputs = [[Filter(G).run(each)[judged(n)] for each in commands] for G in functions]
        return np.array(outputs).transpose(0, 2, 1)
