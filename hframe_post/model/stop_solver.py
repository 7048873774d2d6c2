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
``W``           root of each sample's weight, see ``native/stop.c``
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

import numpy as np

from hframe_post.arrays import TS, Array
from hframe_post.model.lpfbs import bsplines
from hframe_post.model.plant import Plant
from hframe_post.native.judging import sliding_sums
from hframe_post.native.stop import RINGING, SIDE, StopModel

SPACING = (1, 1, 1, 1, 1, 1, 2, 2, 2, 3, 3, 4, 5, 6, 8, 10, 12, 14, 19)  # of knots, from a stop on


def stop_model(
    plant: Plant,
    effort: tuple[float, float],
    belts: Array,
    acceleration: float,
    bed: tuple[tuple[float, float], tuple[float, float]],
) -> StopModel:
    """Return what the stops of a printer have in common.

    plant: the one the strategy assumes; effort: λ of x and y; belts (2, 2): from x, y to the
    belts; acceleration: mm/s², the limit of the belts; bed: (least, greatest) of x and of y, mm.
    """
    splines, reach = _graded_splines()
    # a tenth of the effort elsewhere, since a stop is short and asks for more
    efforts, edges = (max(0.1 * e, 1e-3) for e in effort), np.transpose(bed).ravel()
    x_c = plant.racking.x_c if plant.racking else 0.0
    usable = 0.8 * acceleration * TS**2  # firmware needs the rest to be in time
    bounds = np.array([*efforts, *belts.ravel(), *edges, usable, x_c])
    taps, ahead = [G.taps(plant.ahead) for G in plant.responses], plant.ahead
    filters = np.zeros((len(taps), 2 + max(map(len, taps))))
    for G, row, of_filter in zip(plant.responses, filters, taps, strict=True):
        row[:2], row[len(row) - len(of_filter) :] = (G.rest, G.lag), of_filter[::-1]
    outputs = np.ascontiguousarray([_outputs(row, splines, ahead) for row in filters])
    return StopModel(splines, reach, filters, ahead, outputs, bounds)


def _outputs(response: Array, splines: Array, ahead: int) -> Array:
    """Return the outputs (t, 2k + 1) of one of the filters; see ``StopModel``."""
    (rest, lag), taps, k = response[:2], response[2:], splines.shape[1]
    length = SIDE + max(len(taps), SIDE + RINGING) + 2
    commands = np.zeros((2 * k + 1, length))
    commands[:k, :SIDE] = splines.T[::-1, ::-1]
    commands[k, SIDE:] = 1.0
    commands[k + 1 :, SIDE : 2 * SIDE] = splines.T
    speeds = np.diff(commands, axis=1, prepend=0.0)
    outputs = rest * commands - lag * speeds
    # an acceleration that lasts for few samples, in all that the filter remembers
    rates = np.diff(speeds, axis=1, prepend=0.0)[:, : 2 * SIDE + 2]
    known = np.pad(taps[::-1], (rates.shape[1] - 1, length + ahead))
    for rate, output in zip(rates, outputs, strict=True):
        output += sliding_sums(rate[::-1].copy(), known)[ahead : ahead + length]
    return np.asarray(outputs.T)


def _graded_splines() -> tuple[Array, Array]:
    """Return splines at 1 … SIDE samples from a stop (SIDE, k), and how far each reaches (k,).

    They are free at the stop and end smoothly at zero on the far side.
    """
    degree = 3
    inner = np.concatenate([[0.0], np.cumsum(SPACING, dtype=float)])
    inner = inner[inner <= SIDE]
    beyond = inner[-1] + 1.0 + np.arange(degree)
    knots = np.concatenate([np.zeros(degree), inner, beyond])
    N = bsplines(knots, degree, np.minimum(np.arange(1.0, SIDE + 1.0), knots[-1]))
    reach = knots[degree + 1 :]
    inside = (reach <= inner[-1]) & N.any(axis=0)  # the first spline ends before the first sample
    return np.ascontiguousarray(N[:, inside]), reach[inside]
