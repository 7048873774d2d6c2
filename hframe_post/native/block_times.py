"""How long Marlin takes for a block, by the generation of its planner.

Rates are steps per second of the motor that makes most steps in the block, *n* of them; *a* is
its acceleration, steps/s². A block begins at one rate, runs at its nominal rate and ends at a
third. The interval to the next step is a whole number of ticks of a timer.

============ ========== ============================== ============== =====================
generation   rates      the rising ramp is ahead by    falling steps  begins at
============ ========== ============================== ============== =====================
2.0          whole      nothing                        rounded down   120 steps/s or more
2.1          whole      the whole first interval       rounded down   120 steps/s or more
2.1-dev      whole      half the first interval        rounded up     √(a/2) or more
ft-motion    as asked   (exact trapezoids in time)                    √(a/2) or more
============ ========== ============================== ============== =====================

2.0 is 2.0.9.x, 2.1 is 2.1.1 to 2.1.2.x, 2.1-dev the development branch since October 2024, in
which a ramp that falls after a cruise is ahead by half an interval, too. ft-motion is fixed-time
motion of such builds, with the trapezoidal trajectory and no shaper; its times are in
``firmware.marlin.planner``.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass, replace
from functools import cached_property

import numpy as np

from hframe_post.arrays import Array
from hframe_post.native import kernels
from hframe_post.native.whole_steps import Blocks

SLOWEST = 120.0  # steps/s, before the development branch
FASTEST = 3.0  # times a block's mean rate, the most that is asked for to make up for its ramps
ROUNDS = 3  # of the rates' dependence on their neighbours'


@dataclass(frozen=True)
class Stepper:
    """The stepper interrupt of a build, and where its blocks begin.

    hz: of its timer. extra_tick: that counts one tick more than it is set to. smoothing_hz:
    interrupts a second up to which ADAPTIVE_STEP_SMOOTHING makes 2, 4, 8 … of each step; 0: off.
    ahead: share of the first interval by which a rising ramp is ahead. development: 2.1-dev.
    s_curve: ramps are those of S_CURVE_ACCELERATION. False for 2.1-dev: its profile is refused.
    free_entry: blocks begin at their own speed if their corners allow it, as with CLASSIC_JERK.
    """

    hz: float
    extra_tick: bool
    smoothing_hz: float
    ahead: float
    development: bool = False
    s_curve: bool = False
    free_entry: bool = False

    @cached_property
    def row(self) -> Array:
        """Return it as the compiled loops take it, (7,)."""
        *own, _ = astuple(self)
        return np.array([*own, SLOWEST])

    @cached_property
    def unrounded(self) -> Stepper:
        """Return it with ticks too short for rounding to matter."""
        return replace(self, hz=1e15, extra_tick=False, smoothing_hz=0.0)


def block_times(blocks: Blocks, begin: Array, rate: Array, end: Array, stepper: Stepper) -> Array:
    """Return the seconds (k,) of blocks from the rates (k,) at which they begin, run and end."""
    return kernels.marlin_block_times(blocks.n, blocks.a, begin, rate, end, stepper.row)


def step_times(blocks: Blocks, begin: Array, rate: Array, end: Array, stepper: Stepper) -> Array:
    """Return when each step of all blocks is made, (m,), in seconds from the start of the first.

    The arguments are those of ``block_times``.
    """
    n = blocks.n.astype(np.int64)
    t = np.empty(n.sum())
    kernels.marlin_step_times(n, blocks.a, begin, rate, end, stepper.row, t)
    return t


def joined_times(blocks: Blocks, v: Array, rate: Array, before: float, stepper: Stepper) -> Array:
    """Return the seconds (k,) of successive blocks at speeds v (k,) and their rates, as rounded.

    before: speed of the block that precedes. The last ends at its own speed.
    """
    own = v, rate, before, stepper.free_entry, stepper.row
    return kernels.marlin_times(*blocks, *own)


def feed_rates(blocks: Blocks, T: Array, before: float, stepper: Stepper) -> Array:
    """Return speeds (k,), mm/s, at which blocks take the time T (k,); see ``joined_times``."""
    own = T, before, stepper.free_entry, stepper.row, ROUNDS, FASTEST
    return kernels.marlin_feed_rates(*blocks, *own)
