"""Running statistics equal those of the whole stream, however it was cut."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hframe_post.arrays import Array
from hframe_post.prediction.statistics import SMALLEST, ErrorStatistics

ERRORS = st.lists(st.floats(0.0, 250.0), min_size=1, max_size=60).map(np.array)
CUTS = st.lists(st.integers(0, 60), max_size=5)
BIN = 1.0 + 1.0 / 128.0


def statistics(errors: Array, cuts: list[int] | None = None) -> ErrorStatistics:
    running = ErrorStatistics()
    for piece in np.split(errors, sorted(min(c, len(errors)) for c in cuts or [])):
        running.add(piece)
    return running


@given(ERRORS)
def test_rms_and_peak_are_exact(errors: Array) -> None:
    running = statistics(errors)
    assert running.count == len(errors)
    assert running.rms == pytest.approx(np.sqrt(np.square(errors).mean()), rel=1e-12)
    assert running.peak == errors.max()


@given(ERRORS, st.floats(0.01, 1.0))
def test_percentiles_are_within_their_bin(errors: Array, share: float) -> None:
    """Never below the true one, at most a bin above, and never below the smallest."""
    true = np.quantile(errors, share, method="inverted_cdf")
    got = statistics(errors).percentile(share)
    rounding = 1.0 + 1e-9
    assert got <= max(true, SMALLEST) * BIN * rounding
    assert got * rounding >= true
    assert got <= errors.max()


@given(ERRORS, CUTS)
def test_cuts_change_nothing_but_the_rounding_of_the_sum(errors: Array, cuts: list[int]) -> None:
    one, other = statistics(errors), statistics(errors, cuts)
    assert (one.count, one.peak) == (other.count, other.peak)
    np.testing.assert_array_equal(one.histogram, other.histogram)
    assert one.squares == pytest.approx(other.squares, rel=1e-12)
