"""Time as the writer keeps it, from one batch to the next."""

from dataclasses import replace

import numpy as np

from hframe_post.arrays import TS
from hframe_post.firmware.klipper.firmware import Klipper
from hframe_post.firmware.registry import firmware
from hframe_post.printer.profile import load
from hframe_post.printer.settings import Printer
from hframe_post.writers.carried import NOTHING_BETWEEN
from hframe_post.writers.decimation import Units
from hframe_post.writers.machine import Motion
from hframe_post.writers.timing import TimedMotion, Timing

UNITS = Units(finer=2)  # of a sweep
STEADY = 200  # segments
N = 1000  # segments, in two batches
HZ, SPEED, MORE = 60.0, 15.0, 10.0  # of a motion whose speed is a sine, mm/s


def test_a_batch_ends_as_slowly_as_the_next_begins(paper: Printer) -> None:
    """Klipper brakes for the next batch inside the last segment of this one."""
    t = np.arange(N + 1) * TS
    at = np.zeros((N + 1, 4))
    at[:, 0] = SPEED * t + MORE / (2.0 * np.pi * HZ) * np.sin(2.0 * np.pi * HZ * t)
    T, rest, rules = np.full(N, TS), np.zeros(N + 1, dtype=bool), Klipper(paper).motion(None)
    for cut in range(N // 2, N // 2 + 17):  # wherever in a period a batch may end
        timing = Timing(rules, UNITS, STEADY)
        first = timing.feeds(at[: cut + 1], T[:cut], rest[: cut + 1].copy(), np.inf)
        second = timing.feeds(at[cut:], T[cut:], rest[cut:].copy(), np.inf)
        v, begun = np.append(first, second) / UNITS.per_feed, np.append(True, rest[1:])
        late = rules.durations(at, v, begun, 0.0) - T
        assert abs(timing.lag - late[1:].sum()) < 1e-9  # the first need not be made up for


def test_a_motion_between_rests_is_in_time_with_the_ramps_at_both_ends(paper: Printer) -> None:
    rules, units, T = Klipper(paper).motion(None), Units(0), np.full(4, 0.02)
    at = np.zeros((5, 4), dtype=np.int64)
    at[:, 0] = np.rint(units.per_mm[0] * np.arange(5.0))
    timing = Timing(rules, units)
    [timed] = timing.timed([Motion(at, T, np.zeros(4, np.int64), NOTHING_BETWEEN, True, np.inf)])
    assert isinstance(timed, TimedMotion)
    rest = np.array([True, False, False, False, True])
    late = rules.durations(at / units.per_mm, timed.feeds / units.per_feed, rest, 0.0) - T
    assert abs(late.sum()) < 1e-5, "s by which the motion is late"
    assert abs(timing.lag - late[1:].sum()) < 1e-9, "s of lag that are not true"


def test_a_short_motion_that_must_be_late_gets_a_speed_that_can_be_written() -> None:
    """To be in time, its first segment of six steps would have to take less than no time."""
    printer = load("paper-marlin")
    assert printer.firmware.marlin is not None
    marlin = replace(printer.firmware.marlin, planner="2.1-dev")
    printer = replace(printer, firmware=replace(printer.firmware, tables=(marlin,)))
    timing = Timing(firmware(printer).motion(None), Units(0))
    timing._before = 39.68  # mm/s, of the retraction before it
    x, e = [113.218, 113.341, 113.218], [0.0, 0.00281, 0.00996]
    at = np.column_stack([x, np.full(3, 102.67), np.full(3, 27.7), e])
    feeds = timing.feeds(at, np.array([0.01, 0.095]), np.zeros(3, dtype=bool), 7.92)
    assert (feeds < 1000.0 * Units(0).per_feed).all()  # 1 m/s
