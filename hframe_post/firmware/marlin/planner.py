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
motion of such builds, with the trapezoidal trajectory and no shaper.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hframe_post.arrays import Array
from hframe_post.firmware import ramps

ROUNDS = 3  # of the rates' dependence on their neighbours'
GOLDEN = (5.0**0.5 - 1.0) / 2.0  # its multiples fall evenly between whole numbers
FASTEST = 3.0  # times a block's mean rate, asked for to make up for its ramps
TOP = 0.9  # of that, from which a rate is no longer free
MOST_LOST = 0.01  # share of time that rounding can lose
ROUNDING = 0.05  # share of a block's time, beyond which it is not rounding that is late


class Blocks(NamedTuple):
    """Blocks (k,): steps n, mm of path d, acceleration a (steps/s²).

    corners (k + 1,): greatest speeds, mm/s, at which their ends may be passed, or one for all.
    """

    n: Array
    d: Array
    a: Array
    corners: Array | float = math.inf


@dataclass(frozen=True, slots=True)
class Timer:
    """Of the stepper.

    extra_tick: it counts one tick more than it is told; smoothing_hz: interrupts a second up to
    which ADAPTIVE_STEP_SMOOTHING makes 2, 4, 8 … of each step, 0: it does not.
    """

    hz: float
    extra_tick: bool = False
    smoothing_hz: float = 0.0

    def interrupts(self, rate: Array) -> Array:
        """How many a step takes, (k,), in blocks of nominal rates (k,)."""
        below = np.ceil(self.smoothing_hz / rate) - 1.0  # most that stay under smoothing_hz
        return np.exp2(np.floor(np.log2(np.maximum(below, 1.0))))

    def ticks(self, rate: Array) -> Array:
        """What the timer is told for interrupts (k,) a second."""
        return np.floor(self.hz / rate)

    def step(self, rate: Array) -> Array:
        """How long a step takes, (k,), at rates (k,) that do not change."""
        shares = self.interrupts(rate)
        return shares * self.seconds(self.ticks(rate * shares))

    def seconds(self, ticks: Array) -> Array:
        """How long an interval of that many ticks takes."""
        return (ticks + float(self.extra_tick)) / self.hz


UNROUNDED = Timer(1e15)  # ticks so short that rounding to them is none


@dataclass(frozen=True, slots=True)
class Planner:
    """A generation, by what tells it from the others; see above."""

    risen: float  # share of the first interval by which the rising ramp is ahead
    fallen: float  # share of an interval of cruise by which the falling ramp is
    development: bool = False  # its ramps are an interval shorter at the top, longer at the foot
    whole_rates: bool = True
    own_entry: bool = False  # blocks begin at their own speed: CLASSIC_JERK that limits nothing
    s_curve: bool = False  # ramps are S_CURVE_ACCELERATION's

    @property
    def least_rate(self) -> float:
        """At which a block may begin, steps/s."""
        return 1.0 if self.development else 120.0

    def possible(self, blocks: Blocks, T: Array, before: float) -> Array:
        """Times (k,) as near to T (k,) as blocks can last; before: see ``Player``."""
        n = blocks.n
        T = np.minimum(T, n / self.least_rate)
        if not self.whole_rates:
            return T
        for _ in range(ROUNDS):
            shortest = self._unrounded_times(blocks, FASTEST * n / T, before)
            if (shortest <= T).all():
                break
            T = np.maximum(T, shortest)
        return T

    def feed_rates(self, blocks: Blocks, T: Array, before: float, timer: Timer) -> Array:
        """Speeds (k,), mm/s, at which blocks take the time T (k,); before: see ``Player``."""
        n, d, *_ = blocks
        if not self.whole_rates:
            a, least = self._trapezoids(blocks)
            return ramps.speeds(d, T, a, blocks.corners, before, least)
        rate, lost = n / T, 0.0
        for _ in range(ROUNDS):  # rounding makes ramps of its own, which lose time
            for _ in range(ROUNDS):
                rate *= self._unrounded_times(blocks, rate, before) / (T * (1.0 - lost))
                rate = np.clip(rate, n / T / FASTEST, n / T * FASTEST)  # ramps may be too long
            whole = _dithered(rate, timer)
            v = (whole - 0.5) * d / n  # Marlin rounds up
            late = self._block_times(blocks, v, whole, before, timer) - T
            no_rate_fits = (np.abs(late) > ROUNDING * T) | (rate > TOP * FASTEST * n / T)
            late[no_rate_fits] = 0.0
            lost = min(max(lost + float(late.sum() / T.sum()), -MOST_LOST), MOST_LOST)
        return np.asarray(v)

    def durations(self, blocks: Blocks, v: Array, before: float, timer: Timer) -> Array:
        """Time (k,) of blocks at speeds v (k,), mm/s.

        Whether the first begins at rest is not known, nor needed.
        """
        n, d, *_ = blocks
        if not self.whole_rates:
            a, least = self._trapezoids(blocks)
            return ramps.durations(d, v, a, blocks.corners, before, least)
        return self._block_times(blocks, v, np.ceil(v * n / d), before, timer)

    def stroke(self, blocks: Blocks, joint: Array, v: Array, timer: Timer) -> float:
        """Seconds for blocks at speeds v (k,), mm/s, whose ends are passed at joint (k + 1,)."""
        n, d, *_ = blocks
        a, least = self._trapezoids(blocks)
        joint = joint.copy()
        joint[:-1] = np.maximum(joint[:-1], np.minimum(least, v))
        joint[-1] = max(joint[-1], min(float(least[-1]), float(v[-1])))
        for k in range(len(v)):  # what can be reached
            joint[k + 1] = min(joint[k + 1], np.sqrt(joint[k] ** 2 + 2.0 * a[k] * d[k]))
        for k in reversed(range(len(v))):
            joint[k] = min(joint[k], np.sqrt(joint[k + 1] ** 2 + 2.0 * a[k] * d[k]))
        v_s, v_e = joint[:-1], joint[1:]
        if self.whole_rates:
            taken = self.times(blocks, v_s * n / d, np.ceil(v * n / d), v_e * n / d, timer)
        else:
            v = np.minimum(v, np.sqrt(a * d + (v_s**2 + v_e**2) / 2.0))
            taken = (d + ((v - v_s) ** 2 + (v - v_e) ** 2) / (2.0 * a)) / v
        return float(taken.sum())

    def _trapezoids(self, blocks: Blocks) -> tuple[Array, Array]:
        """Acceleration of the path, least speeds of entry."""
        n, d, a, _ = blocks
        least = np.sqrt(a / 2.0) * d / n if self.development else np.zeros(len(n))
        if self.own_entry:
            least[:] = np.inf
        return a * d / n, least

    def _unrounded_times(self, blocks: Blocks, rate: Array, before: float) -> Array:
        """Time (k,) of blocks at nominal rates (k,) that need not be whole."""
        v = rate * blocks.d / blocks.n
        return self._block_times(blocks, v, rate, before, UNROUNDED)

    def _block_times(
        self, blocks: Blocks, v: Array, rate: Array, before: float, timer: Timer
    ) -> Array:
        """Time (k,) of blocks at speeds v and nominal rates (k,), of which the last keeps its."""
        n, d, *_ = blocks
        _, least = self._trapezoids(blocks)
        v_s, v_e = ramps.ends(v, blocks.corners, before, least)
        per_mm = n / d if self.development else rate / v  # releases: of the rate as it is rounded
        return self.times(blocks, v_s * per_mm, rate, v_e * per_mm, timer)

    def times(self, blocks: Blocks, begin: Array, rate: Array, end: Array, timer: Timer) -> Array:
        """Time (k,) of blocks from rates ``begin`` over nominal ``rate`` to ``end``, all (k,)."""
        n, _, a, _ = blocks
        begin, end = (np.minimum(self._whole(w), rate) for w in (begin, end))
        up, down = self._ramp_steps(n, a, begin, rate, end)
        shares = timer.interrupts(rate)
        late = 0 if self.development else 1
        after_first = n * shares - 1
        rising = np.clip(up * shares - 1 + late, 0, after_first)
        falling = np.clip(down * shares - late, 0, after_first - rising)
        cruising = after_first - rising - falling
        first, cruise = timer.ticks(begin * shares), timer.ticks(rate * shares)
        reach = self._reached(begin, rate, a, up, n - up - down)
        climb, top = _ramp(begin, reach, a, rising, self.risen * first, shares, timer, self.s_curve)
        top = reach if self.s_curve else top
        ahead = np.where(rising > 0, 0.0, self.fallen * first)
        if self.development:
            top = np.where(cruising > 0, rate, top)
            ahead = np.where(cruising > 0, self.fallen * cruise, ahead)
        top = np.maximum(top, end)
        drop, _ = _ramp(top, end, a, falling, ahead, shares, timer, self.s_curve)
        return np.asarray(timer.seconds(first) + climb + cruising * timer.seconds(cruise) + drop)

    def _reached(self, begin: Array, rate: Array, a: Array, up: Array, plateau: Array) -> Array:
        """Rates (k,) to which the ramps rise: a curve must know where it will end."""
        if not self.s_curve:
            return rate
        return np.where(plateau > 0.0, rate, np.minimum(np.sqrt(begin**2 + 2.0 * a * up), rate))

    def _whole(self, rate: Array) -> Array:
        """Rates (k,) at which blocks begin and end, as they are rounded."""
        whole = np.rint(rate) if self.development else np.ceil(rate - 1e-6)
        return np.maximum(whole, self.least_rate)

    def _ramp_steps(
        self, n: Array, a: Array, begin: Array, rate: Array, end: Array
    ) -> tuple[Array, Array]:
        """Steps (k,) that are given to the rising and to the falling ramp."""
        rise, fall = ((rate**2 - w**2) / (2.0 * a) for w in (begin, end))
        meet = (n + rise - fall) / 2.0
        if self.development:
            up, down, meet = np.ceil(rise), np.ceil(fall), np.rint(meet)
        else:
            up, down, meet = np.ceil(rise), np.floor(fall), np.ceil(meet)
        meet = np.clip(meet, 0.0, n)
        short = up + down > n
        return np.where(short, meet, up), np.where(short, n - meet, down)


PLANNERS = {
    "2.0": Planner(risen=0.0, fallen=0.0),
    "2.1": Planner(risen=1.0, fallen=0.0),
    "2.1-dev": Planner(risen=0.5, fallen=0.5, development=True),
    "ft-motion": Planner(risen=0.5, fallen=0.5, development=True, whole_rates=False),
}


def _dithered(rate: Array, timer: Timer) -> Array:
    """Whole rates (k,) of whole ticks, above and below rates (k,) so that none adds up."""
    threshold = np.modf(GOLDEN * np.arange(1, len(rate) + 1))[0]
    shares = timer.interrupts(rate)
    ticks = np.floor(timer.hz / (rate * shares) - float(timer.extra_tick) + threshold)
    slow = rate * rate * shares < timer.hz  # whole rates are finer than whole ticks
    whole = np.where(slow, rate + threshold, timer.hz / np.maximum(ticks, 1.0) / shares)
    return np.asarray(np.maximum(np.floor(whole), 1.0))


def _ramp(
    start: Array,
    end: Array,
    a: Array,
    interrupts: Array,
    ahead: Array,
    shares: Array,
    timer: Timer,
    s_curve: bool,
) -> tuple[Array, Array]:  # fmt: skip
    """Time (k,) of the interrupts in which rates go from start to end, and the rates reached.

    ahead (k,): ticks by which the ramp is ahead; shares (k,): interrupts a step.
    """
    taken, t, now = np.zeros(len(start)), ahead / timer.hz, start
    for k in range(int(interrupts.max(initial=0.0))):
        ramping = k < interrupts
        now = np.where(ramping, _rate_at(t, start, end, a, s_curve), now)
        ticks = timer.ticks(now * shares)
        taken = np.where(ramping, taken + timer.seconds(ticks), taken)
        t = t + ticks / timer.hz
    return taken, now


def _rate_at(t: Array, start: Array, end: Array, a: Array, s_curve: bool) -> Array:
    """Whole rates (k,) at t (k,) s: along a line, or along a Bézier curve as long as it."""
    way = end - start
    if not s_curve:
        return np.asarray(start + np.sign(way) * np.minimum(np.floor(a * t), np.abs(way)))
    with np.errstate(divide="ignore", invalid="ignore"):
        u = np.where(way != 0.0, np.clip(a * t / np.abs(way), 0.0, 1.0), 1.0)
    return np.asarray(np.floor(start + way * u**3 * (10.0 - 15.0 * u + 6.0 * u * u)))
