"""Running statistics: exact, or within a bin."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hframe_post.arrays import Array
from hframe_post.prediction.statistics import SMALLEST, ErrorStatistics

ERRORS = st.lists(st.floats(0.0, 250.0), min_size=1, max_size=60).map(np.array)
BIN = 1.0 + 1.0 / 128.0


def statistics(errors: Array) -> ErrorStatistics:
    running = ErrorStatistics()
    running.add(errors)
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
