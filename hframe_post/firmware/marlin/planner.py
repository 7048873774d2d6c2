"""Feed rates at which blocks last as long as they are to, by the generation of Marlin's planner.

``native.block_times`` has the rules, the symbols and the rates. Speeds and path lengths are in mm.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from hframe_post.arrays import TS, Array
from hframe_post.firmware.motion import travelled
from hframe_post.native import ramps
from hframe_post.native.block_times import (
    FASTEST,
    ROUNDS,
    SLOWEST,
    Stepper,
    block_times,
    feed_rates,
    joined_times,
    step_times,
)
from hframe_post.native.whole_steps import Blocks
from hframe_post.printer.firmware_tables import MarlinTable


def along(blocks: Blocks) -> Array:
    """Return the accelerations (k,) of blocks along their paths, mm/s²."""
    return blocks.a * blocks.d / blocks.n


class Planner(ABC):
    """A planner. stall: seconds of the first step from rest. before: see ``MotionRules``."""

    fixed_time: ClassVar[bool] = False

    @property
    def stall(self) -> float:
        return 0.0

    @abstractmethod
    def possible_times(self, blocks: Blocks, T: Array, before: float) -> Array:
        """Return times (k,) as near to T (k,) as blocks can last."""

    @abstractmethod
    def feed_rates(self, blocks: Blocks, T: Array, before: float) -> Array:
        """Return speeds (k,), mm/s, at which blocks take the time T (k,)."""

    @abstractmethod
    def durations(self, blocks: Blocks, v: Array, before: float) -> Array:
        """Return the seconds (k,) of blocks at speeds v (k,), mm/s.

        Whether the first begins at rest is not known, nor needed.
        """

    def least_entry(self, blocks: Blocks) -> Array:
        """Return the least speeds (k,), mm/s, at which blocks begin."""
        return np.sqrt(blocks.a / 2.0) * blocks.d / blocks.n

    def entry(self, blocks: Blocks, v: Array, before: float) -> Array:
        """Return the speeds (k,), mm/s, at which blocks begin that run at v (k,)."""
        return ramps.ends(v, blocks.corners, before, self.least_entry(blocks))[0]

    @abstractmethod
    def seconds(self, blocks: Blocks, v_s: Array, v_e: Array, v: Array) -> Array:
        """Return the seconds (k,) of blocks at v (k,), between speeds (k,) that they can reach."""

    @abstractmethod
    def travelled(self, blocks: Blocks, v_s: Array, v_e: Array, v: Array) -> Array:
        """Return mm of path (m,) every 1 ms; see ``seconds``."""

    def reachable(self, blocks: Blocks, joint: Array, v: Array) -> tuple[Array, Array]:
        """Return speeds (k,) at the start and end of each block that its acceleration can reach.

        joint (k + 1,): the speeds asked for; v (k,): those inside blocks.
        """
        d, a, least, joint = blocks.d, along(blocks), self.least_entry(blocks), joint.copy()
        joint[:-1] = np.maximum(joint[:-1], np.minimum(least, v))
        joint[-1] = max(joint[-1], min(float(least[-1]), float(v[-1])))
        for k in range(len(v)):
            joint[k + 1] = min(joint[k + 1], np.sqrt(joint[k] ** 2 + 2.0 * a[k] * d[k]))
        for k in reversed(range(len(v))):
            joint[k] = min(joint[k], np.sqrt(joint[k + 1] ** 2 + 2.0 * a[k] * d[k]))
        return joint[:-1], joint[1:]


@dataclass(frozen=True, slots=True)
class SteppedPlanner(Planner):
    """A planner whose ramps change the rate from step to step, by whole steps per second."""

    stepper: Stepper

    @property
    def stall(self) -> float:
        return 0.0 if self.stepper.development else 1.0 / SLOWEST

    def possible_times(self, blocks: Blocks, T: Array, before: float) -> Array:
        n, d, *_ = blocks
        T = np.minimum(T, n / (1.0 if self.stepper.development else SLOWEST))
        for _ in range(ROUNDS):
            rate = FASTEST * n / T
            shortest = joined_times(blocks, rate * d / n, rate, before, self.stepper.unrounded)
            if (shortest <= T).all():
                break
            T = np.maximum(T, shortest)
        return T

    def feed_rates(self, blocks: Blocks, T: Array, before: float) -> Array:
        return feed_rates(blocks, T, before, self.stepper)

    def durations(self, blocks: Blocks, v: Array, before: float) -> Array:
        return joined_times(blocks, v, np.ceil(v * blocks.n / blocks.d), before, self.stepper)

    def least_entry(self, blocks: Blocks) -> Array:
        if self.stepper.development:
            return Planner.least_entry(self, blocks)
        return np.full(len(blocks.n), math.inf if self.stepper.free_entry else 0.0)

    def seconds(self, blocks: Blocks, v_s: Array, v_e: Array, v: Array) -> Array:
        return block_times(blocks, *self._rates(blocks, v_s, v_e, v), self.stepper)

    def travelled(self, blocks: Blocks, v_s: Array, v_e: Array, v: Array) -> Array:
        """Return mm of path (m,) every 1 ms: the mean of the steps made in the ms around it."""
        t = step_times(blocks, *self._rates(blocks, v_s, v_e, v), self.stepper)
        s = np.concatenate([[0.0], np.cumsum(np.repeat(blocks.d / blocks.n, blocks.n.astype(int)))])
        m = int(np.ceil(t[-1] / TS)) + 1
        t = np.concatenate([[-TS, 0.0], t, [(m + 1) * TS]])
        area = np.concatenate([[0.0, 0.0], np.cumsum(s * np.diff(t[1:]))])
        between = (np.arange(m + 1) - 0.5) * TS
        return np.asarray(np.diff(np.interp(between, t, area)) / TS)

    def _rates(
        self, blocks: Blocks, v_s: Array, v_e: Array, v: Array
    ) -> tuple[Array, Array, Array]:
        """Return the rates (k,) at which blocks begin, run and end."""
        rate = np.ceil(v * blocks.n / blocks.d)
        per_mm = blocks.n / blocks.d if self.stepper.development else rate / v
        return v_s * per_mm, rate, v_e * per_mm


class FixedTimePlanner(Planner):
    """The planner of fixed-time motion: exact trapezoids in time."""

    fixed_time = True

    def possible_times(self, blocks: Blocks, T: Array, before: float) -> Array:
        return np.minimum(T, blocks.n)

    def feed_rates(self, blocks: Blocks, T: Array, before: float) -> Array:
        own = blocks.corners, before, self.least_entry(blocks)
        return ramps.speeds(blocks.d, T, along(blocks), *own)

    def durations(self, blocks: Blocks, v: Array, before: float) -> Array:
        own = blocks.corners, before, self.least_entry(blocks)
        return ramps.durations(blocks.d, v, along(blocks), *own)

    def seconds(self, blocks: Blocks, v_s: Array, v_e: Array, v: Array) -> Array:
        a = along(blocks)
        v = np.minimum(v, np.sqrt(a * blocks.d + (v_s**2 + v_e**2) / 2.0))
        return ramps.seconds(blocks.d, v, v_s, v_e, a)

    def travelled(self, blocks: Blocks, v_s: Array, v_e: Array, v: Array) -> Array:
        """Return mm of path (m,) at every 1 ms, where it looks up its place."""
        return travelled(blocks.d, v, v_s, v_e, along(blocks))


def make_planner(table: MarlinTable) -> Planner:
    """Return the planner of a board."""
    if table.planner == "ft-motion":
        return FixedTimePlanner()
    timer = table.timer_hz, table.timer_extra_tick, table.adaptive_step_smoothing
    if table.planner == "2.1-dev":
        return SteppedPlanner(Stepper(*timer, ahead=0.5, development=True))
    ahead = 0.0 if table.planner == "2.0" else 1.0
    own = table.s_curve_acceleration, table.classic_jerk
    return SteppedPlanner(Stepper(*timer, ahead, False, *own))


# Steps by which each brakes late, so that it takes corners faster than it means to. Measured: with
# corners so much faster, exact ramps at 500 mm/s² take 0.1 to 0.4 % less for a cube or a prism, and
# 0.3 to 0.6 % more for a figure of short moves
BRAKES_LATE_STEPS = {"2.0": 1.0, "2.1": 2.2, "2.1-dev": 0.2, "ft-motion": 0.4}
