r"""A stop: the command dwells while the machine does something else.

      command     ____                        ____
             ____/    \                      /    \____
                       \____________________/
                  before   dwell: a … b − 1  after

Only what is printed counts: the nozzle's distance to the path while it extrudes. So the command
may leave the path during travel, may dwell next to it, and may lag or lead along it. The command
around the stop minimises

    ‖W n·(nozzle − foot)‖² + ALONG ‖W t·(nozzle − path)‖² + λ‖E D command‖² + ‖B (command − bed)‖²

==============  =============================================================================
symbol          meaning
==============  =============================================================================
``N, p``        cubic splines, with knots closer together near the stop; their weights
``foot, t, n``  the path's nearest point to the nozzle, the directions along and across there
``W``           root of each sample's weight, see ``model.stop_cost``
``D, λ``        second difference, across the dwell too; effort
``E, B``        roots of weights that keep the belts and the bed's edges within bounds
==============  =============================================================================

The plant is linear and lever arms are those of the path (Remark 2.1 of the paper), so this is a
linear least-squares problem for given feet. Its bounds are met by iteratively reweighted least
squares: a row that exceeds its bound gets more weight, and the problem is solved again.

1. Solve with the feet at the desired places; seek the feet of the nozzle so found; solve again.
2. In each solution, raise E where belts accelerate too hard, and B where the bed is left, up to
   TRIALS times; where belts then exceed their limit, begin again and raise E for that alone, up
   to HARD_TRIALS times. Keep the best command within the belts' limit.
3. While the nozzle is FAR from the path where it extrudes, raise W there and solve again, up to
   EMPHASES times. Keep the command with the least peak.
"""

from __future__ import annotations

from bisect import bisect_right
from functools import lru_cache

import numpy as np

from hframe_post.arrays import TS, Array, X, Y
from hframe_post.model.impulse_response import FiniteFilter
from hframe_post.model.lpfbs import bsplines
from hframe_post.model.plant import Plant
from hframe_post.model.stop_cost import (
    BESIDE,
    BEYOND,
    SHARES,
    SOON,
    Stop,
    Surroundings,
    judged,
    judged_rows,
)
from hframe_post.native.stop import Splines, solve_stop

USABLE = 0.8  # share of the belts' acceleration to use: firmware needs the rest to be in time
AT_DWELL = 0.5  # share of that next to the dwell, where firmware stops within one segment
DWELL_ROWS = 2  # samples of a dwell that second differences can tell apart


class StopSolver:
    """Solver of the commands around stops of one printer.

    plant: the one the strategy assumes; effort: λ of x and y; belts (2, 2): from x, y to the
    belts; acceleration: mm/s², the limit of the belts; bed: (least, greatest) of x and of y, mm.
    """

    def __init__(
        self,
        plant: Plant,
        effort: tuple[float, float],
        belts: Array,
        acceleration: float,
        bed: tuple[tuple[float, float], tuple[float, float]],
    ) -> None:
        self._limit = USABLE * acceleration * TS**2
        # a tenth of the effort elsewhere, since a stop is short and asks for more
        efforts, edges = (max(0.1 * e, 1e-3) for e in effort), np.transpose(bed).ravel()
        self._bounds = np.array([*efforts, *belts.ravel(), *edges, self._limit])
        away, reach = _graded_splines()
        self._reach = reach.tolist()
        self._N_before, self._N_after = away[::-1, ::-1], away
        self.around = AroundStops(plant, self._N_before, self._N_after)
        self._splines = lru_cache(maxsize=32)(self._usable_splines)

    def solve(self, around: Surroundings, command: Array, stop: Stop) -> None:
        """Replace the command of samples a − BESIDE … b + BESIDE − 1.

        command (n, 2): of the whole stretch, so far, from the origin. The path must be known for
        NEAREST samples more on either side, and for BEYOND after; the command for
        ``around.memory`` samples before, and for ``around.ahead`` after that.
        """
        n, origin = stop.b - stop.a, around.origin
        begun = stop.a - BESIDE - self.around.memory
        dwelling = command[begun : stop.b + BESIDE + BEYOND + self.around.ahead].copy()
        dwelling[stop.a - begun : stop.b - begun] = command[stop.a]
        rows = judged_rows(n)
        path = around.path[stop.a - BESIDE + rows[0]] + origin
        known, levers = self.around.known(dwelling, path, n)
        reach = bisect_right(self._reach, stop.before), bisect_right(self._reach, stop.after)
        splines = self._splines(*reach, stop.movable, n)
        numbers = stop.a, stop.b, stop.before, stop.after, stop.ends
        solve_stop(
            around.path, around.extruding, command, rows, numbers, BESIDE, SHARES, SOON, known,
            levers, splines, self._bounds, origin,
        )  # fmt: skip

    def _usable_splines(self, before: int, after: int, movable: bool, n: int) -> Splines:
        """Return the splines of a stop.

        before, after: how many it may use on either side; movable: whether its own place may
        change; n: samples of the dwell.
        """
        k, dwell = len(self._reach), min(n, DWELL_ROWS)
        usable = [range(k - before, k), [k] if movable else [], range(k + 1, k + 1 + after)]
        columns = np.concatenate(usable).astype(np.int64)
        N = np.zeros((BESIDE + dwell + BESIDE + 4, 2 * k + 1))
        N[2 : 2 + BESIDE, :k] = self._N_before
        N[2 + BESIDE : 2 + BESIDE + dwell, k] = 1.0
        N[2 + BESIDE + dwell : -2, k + 1 :] = self._N_after
        limit = np.full(len(N) - 2, self._limit)
        limit[BESIDE:-BESIDE] *= AT_DWELL
        by_p = self.around.by_splines(n)
        return Splines.from_matrices(N[:, columns], by_p[..., columns], limit)


def _graded_splines() -> tuple[Array, Array]:
    """Return splines at 1 … BESIDE samples from a stop (BESIDE, k), and how far each reaches (k,).

    They are free at the stop and end smoothly at zero on the far side.
    """
    degree = 3
    spacing = (1, 1, 1, 1, 1, 1, 2, 2, 2, 3, 3, 4, 5, 6, 8, 10, 12, 14, 19)  # from the stop on
    inner = np.concatenate([[0.0], np.cumsum(spacing, dtype=float)])
    inner = inner[inner <= BESIDE]
    beyond = inner[-1] + 1.0 + np.arange(degree)
    knots = np.concatenate([np.zeros(degree), inner, beyond])
    N = bsplines(knots, degree, np.minimum(np.arange(1.0, BESIDE + 1.0), knots[-1]))
    reach = knots[degree + 1 :]
    inside = (reach <= inner[-1]) & N.any(axis=0)  # the first spline ends before the first sample
    return N[:, inside], reach[inside]


# ----------------------------------------------------------------------
# The plant around a stop. The command there is the known one plus splines before the dwell, a
# shift of the dwell's own place, and splines after it. Every filter is linear, so its output at the
# judged samples is a known part plus a matrix times the weights p of these.


class AroundStops:
    """The plant's motion around stops.

    N_before, N_after (BESIDE, k): the splines on either side of a dwell, in the order of time.
    ahead, memory: samples of the command after a sample, and before it, that the nozzle's place
    depends on.
    """

    def __init__(self, plant: Plant, N_before: Array, N_after: Array) -> None:
        self._N_before, self._N_after = N_before, N_after
        self.ahead = plant.ahead
        self._filters = [FiniteFilter(G, self.ahead) for G in plant.responses]
        self.memory = max(f.memory for f in self._filters)
        self._racking = plant.racking
        self.by_splines = lru_cache(maxsize=32)(self._by_splines)

    def known(self, command: Array, path: Array, n: int) -> tuple[Array, Array]:
        """Return the nozzle (r, 2) without p, and lever arms (0 or 1, r), at the judged samples.

        command: from ``memory`` + BESIDE samples before a dwell of n samples to BESIDE + BEYOND +
        ahead after it, from the origin; path (r, 2): there, mm on the bed.
        """
        u, at = np.ascontiguousarray(command.T), judged(n) + self.ahead
        axes, samples = (X, Y, X)[: len(self._filters)], len(command) - self.memory
        x, y, *theta = (
            f.output(u[axis], samples)[at] for f, axis in zip(self._filters, axes, strict=True)
        )
        nozzle, levers = np.column_stack([x, y]), np.zeros((len(theta), len(at)))
        if self._racking:
            levers[0] = self._racking.lever(path)
            nozzle[:, Y] += levers[0] * theta[0]
        return nozzle, levers

    def _by_splines(self, n: int) -> Array:
        """Return the filters' outputs (2 or 3, r, 2k + 1) by splines and by a dwell of n."""
        k, end = self._N_before.shape[1], BESIDE + n
        commands = np.zeros((2 * k + 1, end + BESIDE + BEYOND + self.ahead))
        commands[:k, :BESIDE] = self._N_before.T
        commands[k, BESIDE:end] = 1.0
        commands[k + 1 :, end : end + BESIDE] = self._N_after.T
        outputs = np.zeros((len(self._filters), 2 * k + 1, len(judged(n))))
        for f, of_filter in zip(self._filters, outputs, strict=True):
            for command, output in zip(commands, of_filter, strict=True):
                known = np.pad(command, (f.memory, 0))
                output[:] = f.output(known, len(command))[judged(n) + self.ahead]
        return outputs.transpose(0, 2, 1)
