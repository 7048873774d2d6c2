"""Lines carried through motion: what has been extruded by then is what the path has there."""

import numpy as np
import pytest

from hframe_post.arrays import Array, Integers
from hframe_post.errors import HframeError
from hframe_post.stream.marks import Mark, Marks
from hframe_post.writers.decimation import Batch, check_filament

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
