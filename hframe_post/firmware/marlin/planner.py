"""Feed rates at which blocks last as long as they are to, by the generation of Marlin's planner.

``block_times`` has the rules, the symbols and the rates. Speeds and path lengths are in mm.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

import numpy as np

from hframe_post.arrays import Array
from hframe_post.firmware import ramps
from hframe_post.firmware.marlin.block_times import SLOWEST, Stepper, Timer, block_times
from hframe_post.firmware.marlin.blocks import Blocks
from hframe_post.native import kernel

ROUNDS = 3  # of the rates' dependence on their neighbours'
FASTEST = 3.0  # times a block's mean rate, the most that is asked for to make up for its ramps
MOST_LOST = 0.01  # share of time that rounding can lose


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
        if (compiled := kernel("marlin_feed_rates")) is None:
            return self._feed_rates(blocks, T, before)
        k, v, room = len(T), np.empty(len(T)), np.empty(3 * len(T))
        own = before, self.free_entry, self.stepper.row
        compiled(k, blocks.n, blocks.d, blocks.a, _corners(blocks), T, *own, room, v)
        return v

    def _feed_rates(self, blocks: Blocks, T: Array, before: float) -> Array:
        n, d, *_ = blocks
        mean, lost = n / T, 0.0
        rate, slowest, fastest = mean, mean / FASTEST, mean * FASTEST
        exact = self.stepper.unrounded
        for _ in range(ROUNDS):  # rounding makes ramps of its own, which lose time
            for _ in range(ROUNDS):
                taken = self._times(blocks, rate * d / n, rate, before, exact)
                rate = rate * (taken / (T * (1.0 - lost)))
                rate = np.minimum(np.maximum(rate, slowest), fastest)  # ramps may be too long
            whole = _dithered(rate, self.stepper.timer)
            v = (whole - 0.5) * d / n  # Marlin rounds up
            late = self._times(blocks, v, whole, before, self.stepper) - T
            # lateness of more than 5 % is not due to rounding, and a rate at its bound not free
            no_rate_fits = (np.abs(late) > 0.05 * T) | (rate > 0.9 * FASTEST * n / T)
            late[no_rate_fits] = 0.0
            share = float(np.cumsum(late)[-1] / np.cumsum(T)[-1])  # sums in order
            lost = min(max(lost + share, -MOST_LOST), MOST_LOST)
        return np.asarray(v)

    def durations(self, blocks: Blocks, v: Array, before: float) -> Array:
        """Return the seconds (k,) of blocks at speeds v (k,), mm/s.

        Whether the first begins at rest is not known, nor needed.
        """
        return self._times(blocks, v, np.ceil(v * blocks.n / blocks.d), before, self.stepper)

    def stroke(self, blocks: Blocks, joint: Array, v: Array) -> tuple[Array, Array, Array]:
        """Return at which speeds blocks begin and end, and how long they last, (k,) each.

        v (k,): speeds asked for inside them; joint (k + 1,): at their ends, both in mm/s.
        """
        n, d, *_ = blocks
        v_s, v_e = _reachable(blocks, joint, v, self._least_entry(blocks))
        rates = v_s * n / d, np.ceil(v * n / d), v_e * n / d
        return v_s, v_e, block_times(blocks, *rates, self.stepper)

    def entry(self, blocks: Blocks, v: Array, before: float) -> Array:
        """Return the speeds (k,), mm/s, at which blocks begin.

        v (k,), before: see ``MotionRules``.
        """
        return ramps.ends(v, blocks.corners, before, self._least_entry(blocks))[0]

    def _least_entry(self, blocks: Blocks) -> Array:
        """Return the least speeds (k,), mm/s, at which blocks begin."""
        if self.free_entry:
            return np.full(len(blocks.n), math.inf)
        if self.stepper.development:
            return _development_entry(blocks)
        return np.zeros(len(blocks.n))

    def _times(
        self, blocks: Blocks, v: Array, rate: Array, before: float, stepper: Stepper
    ) -> Array:
        """Return the seconds (k,) of blocks at speeds v (k,) and their rates (k,), as rounded.

        The last ends at its own speed.
        """
        n, d, a, _ = blocks
        if (compiled := kernel("marlin_times")) is not None:
            k, taken, own = len(v), np.empty(len(v)), (before, self.free_entry, stepper.row)
            compiled(k, n, d, a, _corners(blocks), v, rate, *own, taken)
            return taken
        v_s, v_e = ramps.ends(v, blocks.corners, before, self._least_entry(blocks))
        # releases: of the rate as it is rounded
        per_mm = n / d if stepper.development else rate / v
        return block_times(blocks, v_s * per_mm, rate, v_e * per_mm, stepper)


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
        n, d, a, _ = blocks
        a = a * d / n
        v_s, v_e = _reachable(blocks, joint, v, _development_entry(blocks))
        v = np.minimum(v, np.sqrt(a * d + (v_s**2 + v_e**2) / 2.0))
        return v_s, v_e, (d + ((v - v_s) ** 2 + (v - v_e) ** 2) / (2.0 * a)) / v


Planner = SteppedPlanner | FixedTimePlanner
GENERATIONS = ("2.0", "2.1", "2.1-dev", "ft-motion")


@cache
def make_planner(
    generation: str, timer: Timer, classic_jerk: bool = False, s_curve: bool = False
) -> Planner:
    """Return the planner of a generation, one of GENERATIONS, in a build with these options."""
    if generation == "ft-motion":
        return FixedTimePlanner()
    if generation == "2.1-dev":
        return SteppedPlanner(Stepper(timer, ahead=0.5, development=True))
    stepper = Stepper(timer, ahead=0.0 if generation == "2.0" else 1.0, s_curve=s_curve)
    return SteppedPlanner(stepper, free_entry=classic_jerk)


def _corners(blocks: Blocks) -> Array:
    return np.full(len(blocks.n) + 1, blocks.corners)


def _development_entry(blocks: Blocks) -> Array:
    return np.sqrt(blocks.a / 2.0) * blocks.d / blocks.n


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


def _dithered(rate: Array, timer: Timer) -> Array:
    """Return whole rates (k,) of whole ticks, spread about rates (k,) so that no error adds up."""
    golden = (5.0**0.5 - 1.0) / 2.0  # its multiples fall evenly between whole numbers
    threshold = np.modf(golden * np.arange(1, len(rate) + 1))[0]
    shares = timer.interrupts(rate)
    ticks = np.floor(timer.hz / (rate * shares) - float(timer.extra_tick) + threshold)
    slow = rate * rate * shares < timer.hz  # whole rates are finer than whole ticks
    whole = np.where(slow, rate + threshold, timer.hz / np.maximum(ticks, 1.0) / shares)
    return np.asarray(np.maximum(np.floor(whole), 1.0))
