"""Feed rates at which blocks last as long as they are to, by the generation of Marlin's planner.

``native.block_times`` has the rules, the symbols and the rates. Speeds and path lengths are in mm.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from hframe_post.arrays import TS, Array
from hframe_post.firmware.motion import travelled
from hframe_post.native import ramps
from hframe_post.native.block_times import (
    FASTEST,
    ROUNDS,
    SLOWEST,
    Stepper,
    Timer,
    block_times,
    feed_rates,
    joined_times,
    least_entry,
    step_times,
)
from hframe_post.native.whole_steps import Blocks


@dataclass(frozen=True, slots=True)
class SteppedPlanner:
    """A planner whose ramps change the rate from step to step, by whole steps per second.

    free_entry: blocks begin at their nominal speed, as with CLASSIC_JERK that limits nothing.
    """

    stepper: Stepper
    free_entry: bool = False

    fixed_time = False

    @property
    def stall(self) -> float:
        """Return the seconds of the first step from rest."""
        return 0.0 if self.stepper.development else 1.0 / SLOWEST

    def possible_times(self, blocks: Blocks, T: Array, before: float) -> Array:
        """Return times (k,) as near to T (k,) as blocks can last; before: see ``MotionRules``."""
        n, d, *_ = blocks
        T = np.minimum(T, n / (1.0 if self.stepper.development else SLOWEST))
        for _ in range(ROUNDS):
            rate = FASTEST * n / T
            shortest = self._times(blocks, rate * d / n, rate, before, self.stepper.unrounded)
            if (shortest <= T).all():
                break
            T = np.maximum(T, shortest)
        return T

    def feed_rates(self, blocks: Blocks, T: Array, before: float) -> Array:
        """Return speeds (k,), mm/s, at which blocks take the time T (k,)."""
        return feed_rates(blocks, T, before, self.free_entry, self.stepper)

    def durations(self, blocks: Blocks, v: Array, before: float) -> Array:
        """Return the seconds (k,) of blocks at speeds v (k,), mm/s.

        Whether the first begins at rest is not known, nor needed.
        """
        return self._times(blocks, v, np.ceil(v * blocks.n / blocks.d), before, self.stepper)

    def stroke(self, blocks: Blocks, joint: Array, v: Array) -> tuple[Array, Array, Array]:
        """Return at which speeds blocks begin and end, and how long they last, (k,) each.

        v (k,): speeds asked for inside them; joint (k + 1,): at their ends, both in mm/s.
        """
        v_s, v_e, rates = self._played(blocks, joint, v)
        return v_s, v_e, block_times(blocks, *rates, self.stepper)

    def reached(self, blocks: Blocks, v_s: Array, v_e: Array, v: Array) -> Array:
        """Return the seconds (k,) of blocks at v (k,), between speeds (k,) that they can reach."""
        per_mm = blocks.n / blocks.d
        if self.stepper.development:
            least = np.minimum(_development_entry(blocks), v)
            v_s, v_e = np.maximum(v_s, least), np.maximum(v_e, least)
        rates = v_s * per_mm, np.ceil(v * per_mm), v_e * per_mm
        return block_times(blocks, *rates, self.stepper)

    def travelled(self, blocks: Blocks, joint: Array, v: Array) -> Array:
        """Return mm of path (m,) every 1 ms: the mean of the steps made in the ms around it.

        The arguments are those of ``stroke``.
        """
        t = step_times(blocks, *self._played(blocks, joint, v)[2], self.stepper)
        s = np.concatenate([[0.0], np.cumsum(np.repeat(blocks.d / blocks.n, blocks.n.astype(int)))])
        m = int(np.ceil(t[-1] / TS)) + 1
        t = np.concatenate([[-TS, 0.0], t, [(m + 1) * TS]])
        area = np.concatenate([[0.0, 0.0], np.cumsum(s * np.diff(t[1:]))])
        between = (np.arange(m + 1) - 0.5) * TS
        return np.asarray(np.diff(np.interp(between, t, area)) / TS)

    def _played(
        self, blocks: Blocks, joint: Array, v: Array
    ) -> tuple[Array, Array, tuple[Array, Array, Array]]:
        """Return speeds at both ends of blocks (k,), and rates there and inside."""
        n, d, *_ = blocks
        v_s, v_e = _reachable(blocks, joint, v, self._least_entry(blocks))
        rate = np.ceil(v * n / d)
        per_mm = n / d if self.stepper.development else rate / v
        return v_s, v_e, (v_s * per_mm, rate, v_e * per_mm)

    def entry(self, blocks: Blocks, v: Array, before: float) -> Array:
        """Return the speeds (k,), mm/s, at which blocks begin.

        v (k,), before: see ``MotionRules``.
        """
        return ramps.ends(v, blocks.corners, before, self._least_entry(blocks))[0]

    def _least_entry(self, blocks: Blocks) -> Array:
        return least_entry(blocks, self.free_entry, self.stepper.development)

    def _times(
        self, blocks: Blocks, v: Array, rate: Array, before: float, stepper: Stepper
    ) -> Array:
        return joined_times(blocks, v, rate, before, self.free_entry, stepper)


@dataclass(frozen=True, slots=True)
class FixedTimePlanner:
    """The planner of fixed-time motion: exact trapezoids in time; see ``SteppedPlanner``."""

    fixed_time = True
    stall = 0.0

    def possible_times(self, blocks: Blocks, T: Array, before: float) -> Array:
        return np.minimum(T, blocks.n)

    def feed_rates(self, blocks: Blocks, T: Array, before: float) -> Array:
        n, d, a, corners = blocks
        return ramps.speeds(d, T, a * d / n, corners, before, _development_entry(blocks))

    def durations(self, blocks: Blocks, v: Array, before: float) -> Array:
        n, d, a, corners = blocks
        return ramps.durations(d, v, a * d / n, corners, before, _development_entry(blocks))

    def entry(self, blocks: Blocks, v: Array, before: float) -> Array:
        return ramps.ends(v, blocks.corners, before, _development_entry(blocks))[0]

    def stroke(self, blocks: Blocks, joint: Array, v: Array) -> tuple[Array, Array, Array]:
        v_s, v_e = _reachable(blocks, joint, v, _development_entry(blocks))
        return v_s, v_e, self.reached(blocks, v_s, v_e, v)

    def reached(self, blocks: Blocks, v_s: Array, v_e: Array, v: Array) -> Array:
        n, d, a, _ = blocks
        a = a * d / n
        v = np.minimum(v, np.sqrt(a * d + (v_s**2 + v_e**2) / 2.0))
        return np.asarray((d + ((v - v_s) ** 2 + (v - v_e) ** 2) / (2.0 * a)) / v)

    def travelled(self, blocks: Blocks, joint: Array, v: Array) -> Array:
        """Return mm of path (m,) at every 1 ms, where it looks up its place."""
        v_s, v_e = _reachable(blocks, joint, v, _development_entry(blocks))
        return travelled(blocks.d, v, v_s, v_e, blocks.a * blocks.d / blocks.n)


Planner = SteppedPlanner | FixedTimePlanner
# Steps by which each brakes late, so that it takes corners faster than it means to. Measured: with
# corners so much faster, exact ramps at 500 mm/s² take 0.1 to 0.4 % less for a cube or a prism, and
# 0.3 to 0.6 % more for a figure of short moves
BRAKES_LATE_STEPS = {"2.0": 1.0, "2.1": 2.2, "2.1-dev": 0.2, "ft-motion": 0.4}


@cache
def make_planner(
    generation: str, timer: Timer, classic_jerk: bool = False, s_curve: bool = False
) -> Planner:
    """Return the planner of a generation, one of MARLIN_PLANNERS, in a build with these options."""
    if generation == "ft-motion":
        return FixedTimePlanner()
    if generation == "2.1-dev":
        return SteppedPlanner(Stepper(timer, ahead=0.5, development=True))
    stepper = Stepper(timer, ahead=0.0 if generation == "2.0" else 1.0, s_curve=s_curve)
    return SteppedPlanner(stepper, free_entry=classic_jerk)


def _development_entry(blocks: Blocks) -> Array:
    return least_entry(blocks, free_entry=False, development=True)


def _reachable(blocks: Blocks, joint: Array, v: Array, least: Array) -> tuple[Array, Array]:
    """Return speeds (k,) at the start and end of each block that its acceleration can reach.

    joint (k + 1,): the speeds asked for; least (k,): those at which blocks begin at least.
    """
    n, d, a, _ = blocks
    a = a * d / n
    joint = joint.copy()
    joint[:-1] = np.maximum(joint[:-1], np.minimum(least, v))
    joint[-1] = max(joint[-1], min(float(least[-1]), float(v[-1])))
    for k in range(len(v)):
        joint[k + 1] = min(joint[k + 1], np.sqrt(joint[k] ** 2 + 2.0 * a[k] * d[k]))
    for k in reversed(range(len(v))):
        joint[k] = min(joint[k], np.sqrt(joint[k + 1] ** 2 + 2.0 * a[k] * d[k]))
    return joint[:-1], joint[1:]
