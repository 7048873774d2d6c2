"""The commands around stops. Symbols are those of ``model.stop_solver``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hframe_post.arrays import Array
from hframe_post.native import kernels

# as in stop.h, in samples: on either side of a dwell, where its command may change; after these,
# judged too, since ringing shows there; on either side of one, where its nearest point is sought
SIDE, RINGING, NEAREST = 100, 100, 24


class Stop(NamedTuple):
    """A stop in a stretch of samples: the command dwells from sample a to b − 1.

    ends: the first sample after b that is not judged, because another stop begins there. before,
    after: samples on either side that may change; movable: whether the place of the dwell may,
    which it must unless only one side does.
    """

    a: int
    b: int
    ends: int
    before: int
    after: int
    movable: bool


@dataclass(frozen=True, slots=True)
class StopModel:
    """What the stops of one printer have in common.

    splines (SIDE, k): those that begin at a dwell, from its first sample to the last; reach (k,):
    how many samples each needs. filters (2 or 3, 2 + m): the plant's responses of x, y and racking:
    gain at rest, lag, and taps by acceleration, the oldest first; ahead: samples of the command
    that a response waits for. outputs (2 or 3, t, 2k + 1): what each filter makes, from SIDE
    samples before a dwell on, of the k splines before it, of a step there and of the k splines
    after it, if it takes no time; later it is at rest. bounds (12,): effort of x and y; from x, y
    to the belts, by rows; the least and then the greatest place on the bed, mm; the belts' limit,
    mm/sample²; x where the lever arm of racking is 0, mm.
    """

    splines: Array
    reach: Array
    filters: Array
    ahead: int
    outputs: Array
    bounds: Array

    @property
    def memory(self) -> int:
        """Return how many samples of the command before a sample its place depends on."""
        return max(int(self.filters.shape[1]) - 2, self.ahead) + 1


def solve_stops(
    xyze: Array, command: Array, stops: Sequence[Stop], first: int, model: StopModel
) -> None:  # fmt: skip
    """Write the command around stops, one after the other, into that of their stretch.

    xyze (n, 4), command (n, 2): samples ``first`` and so on. They must reach beyond each
    stop by SIDE, and there by as much as the plant remembers and by NEAREST; after it by RINGING
    and ``ahead``, too.
    """
    table = np.array(stops, np.int64)
    table[:, :3] -= first  # a, b, ends
    solved = kernels.solve_stops(
        xyze, command, table, model.bounds, model.filters, model.ahead, model.splines, model.reach,
        model.outputs,
    )  # fmt: skip
    assert solved == len(table)
