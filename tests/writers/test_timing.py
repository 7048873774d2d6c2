"""Time as the writer keeps it, and filament where lines are carried through motion."""

import numpy as np
import pytest

from hframe_post.arrays import TS, Array, Integers
from hframe_post.errors import HframeError
from hframe_post.firmware.registry import Klipper, firmware
from hframe_post.printer.profile import load
from hframe_post.printer.settings import Printer
from hframe_post.stream.marks import Mark, Marks
from hframe_post.writers.decimation import Batch, Units, check_filament
from hframe_post.writers.page import NOTHING_BETWEEN
from hframe_post.writers.timing import Motion, Timing
from tests.printers import with_marlin

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
    due = np.array([20, 40, 60, 80])
    timing.motion(Motion(at, T, np.zeros(4, np.int64), due, NOTHING_BETWEEN, stops=True))
    text = timing.page.text()
    assert isinstance(text, bytes)
    v, F = list[float](), ""
    for line in text.decode().splitlines():  # F is written where it changes
        F = line.partition("F")[2] or F
        v.append(float(F) / 60.0)
    rest = np.array([True, False, False, False, True])
    late = rules.durations(at / units.per_mm, np.array(v), rest, 0.0) - T
    assert abs(late.sum()) < 1e-5, "s by which the motion is late"
    assert abs(timing.lag - late[1:].sum()) < 1e-9, "s of lag that are not true"


def test_a_short_motion_that_must_be_late_gets_a_speed_that_can_be_written() -> None:
    """To be in time, its first segment of six steps would have to take less than no time."""
    printer = with_marlin(load("paper-marlin"), planner="2.1-dev")
    timing = Timing(firmware(printer).motion(None), Units(0))
    timing._before = 39.68  # mm/s, of the retraction before it
    x, e = [113.218, 113.341, 113.218], [0.0, 0.00281, 0.00996]
    at = np.column_stack([x, np.full(3, 102.67), np.full(3, 27.7), e])
    feeds = timing.feeds(at, np.array([0.01, 0.095]), np.zeros(3, dtype=bool), 7.92)
    assert (feeds < 1000.0 * Units(0).per_feed).all()  # 1 m/s


ENDS = np.array([10, 20, 30, 40])


def batch(e: Array, *marked: int) -> Batch:
    """41 points, of which the first lies before sample 0, and lines at some of them."""
    points = np.column_stack([np.zeros((41, 3)), e])
    return Batch(
        0, points, Marks.from_lines(Mark(k - 1, b"M106 S%d" % k) for k in marked), last=True
    )


def out(e: Array, ends: Integers = ENDS) -> Array:
    return np.asarray(e[np.append(0, ends)])


def test_segments_that_end_at_the_lines_have_their_filament() -> None:
    e = np.linspace(0.0, 4.0, 41)
    check_filament(batch(e, 1, 10, 20, 40), ENDS, out(e))
    late = out(e)
    late[2] += 0.011
    with pytest.raises(HframeError, match=r"0\.0110 mm of filament .* of 'M106 S20'"):
        check_filament(batch(e, 1, 10, 20, 40), ENDS, late)
    check_filament(batch(e, 1, 10, 40), ENDS, late)  # no line there


def test_a_line_that_waits_for_a_segment_may_wait_where_filament_turns() -> None:
    """Extruding up to it and taken back from it, within one segment of Marlin's."""
    e = 2.0 - np.abs(np.linspace(-2.0, 2.0, 41))
    assert e[20] == 2.0
    coarse = np.array([15, 25, 40])
    check_filament(batch(e, 20), coarse, out(e, coarse))
    lost = out(e, coarse)
    lost[1] -= 0.02
    with pytest.raises(HframeError, match=r"0\.0200 mm"):
        check_filament(batch(e, 20), coarse, lost)


def test_the_first_segment_begins_with_the_standstill_before_it() -> None:
    e = np.linspace(0.0, 4.0, 41)
    early = out(e)
    early[0] = e[0] - 2 * (e[1] - e[0])
    check_filament(batch(e, 5), ENDS, early, still=2)
    with pytest.raises(HframeError, match=r"0\.1000 mm"):
        check_filament(batch(e, 5), ENDS, early, still=1)
