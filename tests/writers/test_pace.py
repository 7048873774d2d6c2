"""Time as the writer keeps it, from one batch to the next."""

from __future__ import annotations

import numpy as np

from hframe_post.arrays import TS
from hframe_post.firmware.klipper.player import Klipper
from hframe_post.printer.settings import Printer
from hframe_post.writers.stream.pace import Pace
from hframe_post.writers.stream.segments import Units

UNITS = Units(finer=2)  # of a sweep
STEADY = 200  # segments
N = 1000  # segments, in two batches
HZ, SPEED, MORE = 60.0, 15.0, 10.0  # of a motion whose speed is a sine, mm/s


def test_a_batch_ends_as_slowly_as_the_next_begins(paper: Printer) -> None:
    """Klipper brakes for the next batch inside the last segment of this one."""
    t = np.arange(N + 1) * TS
    at = np.zeros((N + 1, 4))
    at[:, 0] = SPEED * t + MORE / (2.0 * np.pi * HZ) * np.sin(2.0 * np.pi * HZ * t)
    T, rest, player = np.full(N, TS), np.zeros(N + 1, dtype=bool), Klipper.from_printer(paper)
    for cut in range(N // 2, N // 2 + 17):  # wherever in a period a batch may end
        pace = Pace(player, UNITS, STEADY)
        first = pace.feeds(at[: cut + 1], T[:cut], rest[: cut + 1], np.inf)
        second = pace.feeds(at[cut:], T[cut:], rest[cut:], np.inf)
        v, begun = np.append(first, second) / UNITS.per_feed, np.append(True, rest[1:])
        late = player.durations(at, v, begun, 0.0) - T
        assert abs(pace.lag - late[1:].sum()) < 1e-9  # the first need not be made up for
