"""Each step of Marlin's blocks."""

from __future__ import annotations

import numpy as np
import pytest

from hframe_post.native.block_times import block_times, step_times
from tests.native.cases import single_blocks


@pytest.mark.slow
def test_the_last_step_of_a_block_is_its_end() -> None:
    """On all planners, with each kind of timer; no step comes before the one that precedes it."""
    rng = np.random.default_rng(0)
    for _ in range(200):
        for _, *drawn in single_blocks(rng):
            steps = step_times(*drawn)
            ends = steps[np.cumsum(drawn[0].n).astype(int) - 1]
            np.testing.assert_allclose(ends, np.cumsum(block_times(*drawn)), 1e-10)
            assert (np.diff(steps) > 0.0).all()
