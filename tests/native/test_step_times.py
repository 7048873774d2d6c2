"""Each step of Marlin's blocks."""

import numpy as np
import pytest

from hframe_post.firmware.marlin.planner import SteppedPlanner, make_planner
from hframe_post.native.block_times import Timer, block_times, step_times
from hframe_post.native.whole_steps import Blocks


@pytest.mark.parametrize("build", ["2.0", "2.1", "2.1 curved", "2.1-dev"])
def test_the_last_step_of_a_block_is_its_end(build: str) -> None:
    """With each kind of timer, on blocks too short for their ramps, and at their own rate.

    The times of blocks are compiled, those of steps are not. No step comes before the one that
    precedes it.
    """
    rng = np.random.default_rng(0)
    for _ in range(15):
        k, hz = int(rng.integers(1, 41)), float(rng.choice([2e6, 1e15]))
        n = np.ceil(10.0 ** rng.uniform(0.0, 2.5, k))
        rate = np.ceil(10.0 ** rng.uniform(1.0, 4.5, k))
        begin, end = rate * np.minimum(rng.uniform(0.0, 1.5, (2, k)), 1.0)
        blocks = Blocks(n, n * 0.0025, 10.0 ** rng.uniform(4.0, 7.0, k))
        timer = Timer(hz, bool(rng.random() < 0.5), float(rng.choice([0.0, 4e4])))
        generation, *curved = build.split()
        planner = make_planner(generation, timer, False, bool(curved))
        assert isinstance(planner, SteppedPlanner)
        drawn = blocks, begin, rate, end, planner.stepper
        steps = step_times(*drawn)
        ends = steps[np.cumsum(n).astype(int) - 1]
        np.testing.assert_allclose(ends, np.cumsum(block_times(*drawn)), 1e-10)
        assert (np.diff(steps) > 0.0).all()
