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

Speeds and path lengths are in mm.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from hframe_post.arrays import Array
from hframe_post.firmware import ramps
from hframe_post.firmware.marlin.blocks import Blocks
from hframe_post.native import kernel

SLOWEST = 120.0  # steps/s, before the development branch
ROUNDS = 3  # of the rates' dependence on their neighbours'
FASTEST = 3.0  # times a block's mean rate, the most that is asked for to make up for its ramps
MOST_LOST = 0.01  # share of time that rounding can lose


@dataclass(frozen=True, slots=True)
class Timer:
    """Timer of the steppers.

    extra_tick: it counts one tick more than it is set to. smoothing_hz: interrupts a second up to
    which ADAPTIVE_STEP_SMOOTHING makes 2, 4, 8 … of each step; 0: it is off.
    """

    hz: float
    extra_tick: bool = False
    smoothing_hz: float = 0.0

    @property
    def row(self) -> Array:
        """Return it as the compiled loop takes it, (3,)."""
        return np.array([self.hz, self.extra_tick, self.smoothing_hz])

    def interrupts(self, rate: Array) -> Array:
        """Return the interrupts a step, (k,), in blocks of nominal rates (k,)."""
        below = np.ceil(self.smoothing_hz / rate) - 1.0  # most that stay under smoothing_hz
        _, exponent = np.frexp(np.maximum(below, 1.0))
        return np.asarray(np.ldexp(1.0, exponent - 1))

    def ticks(self, rate: Array) -> Array:
        return np.floor(self.hz / rate)

    def step(self, rate: Array) -> Array:
        """Return the seconds that a step takes, (k,), at constant rates (k,)."""
        shares = self.interrupts(rate)
        return shares * self.seconds(self.ticks(rate * shares))

    def seconds(self, ticks: Array) -> Array:
        return (ticks + float(self.extra_tick)) / self.hz


UNROUNDED = Timer(1e15)  # with ticks too short for rounding to matter

# ---------------------------------------------------------------------- block times
# Each function takes the rates (k,) at which blocks begin, run and end, and returns their
# seconds (k,).

BlockTimes = Callable[[Blocks, Array, Array, Array, Timer, bool], Array]


def _block_times(
    blocks: Blocks, begin: Array, rate: Array, end: Array, timer: Timer, s_curve: bool,
    ahead: float, development: bool = False,
) -> Array:  # fmt: skip
    """Return block times; ahead: share of the first interval, see the table.

    s_curve must be false for 2.1-dev: a profile with an S-curve for it is refused.
    """
    if (compiled := kernel("marlin_block_times")) is None:
        times = _development_times if development else _released_times
        return times(blocks, begin, rate, end, timer, s_curve, ahead)
    k, taken = len(rate), np.empty(len(rate))
    compiled(k, blocks.n, blocks.a, begin, rate, end, timer.row, ahead, development, s_curve, taken)
    return taken


times_2_0 = partial(_block_times, ahead=0.0)
times_2_1 = partial(_block_times, ahead=1.0)
times_2_1_dev = partial(_block_times, ahead=0.5, development=True)


def _released_times(
    blocks: Blocks, begin: Array, rate: Array, end: Array, timer: Timer, s_curve: bool, ahead: float
) -> Array:
    """Return block times of 2.0 and 2.1."""
    n, _, a, _ = blocks
    begin, end = (np.minimum(np.maximum(np.ceil(w - 1e-6), SLOWEST), rate) for w in (begin, end))
    rise, fall, meet = _ramp_lengths(n, a, begin, rate, end)
    up, down = _fitting(n, np.ceil(rise), np.floor(fall), np.ceil(meet))
    shares = timer.interrupts(rate)
    after_first = n * shares - 1
    rising = np.clip(up * shares, 0, after_first)
    falling = np.clip(down * shares - 1, 0, after_first - rising)
    cruising = after_first - rising - falling
    first, cruise = timer.ticks(begin * shares), timer.ticks(rate * shares)
    reach = rate
    if s_curve:  # a curve must know where it will end
        met = np.minimum(np.sqrt(begin**2 + 2.0 * a * up), rate)
        reach = np.where(n - up - down > 0.0, rate, met)
    climb, top = _ramp(begin, reach, a, rising, ahead * first, shares, timer, s_curve)
    top = np.maximum(reach if s_curve else top, end)
    drop, _ = _ramp(top, end, a, falling, np.zeros(len(n)), shares, timer, s_curve)
    return np.asarray(timer.seconds(first) + climb + cruising * timer.seconds(cruise) + drop)


def _development_times(
    blocks: Blocks, begin: Array, rate: Array, end: Array, timer: Timer, s_curve: bool, ahead: float
) -> Array:
    """Return block times of 2.1-dev, whose ramps are ahead by half an interval.

    They are an interval shorter at the top than before, and an interval longer at the foot.
    """
    n, _, a, _ = blocks
    # Marlin rounds halves up
    begin, end = (np.minimum(np.maximum(np.floor(w + 0.5), 1.0), rate) for w in (begin, end))
    rise, fall, meet = _ramp_lengths(n, a, begin, rate, end)
    up, down = _fitting(n, np.ceil(rise), np.ceil(fall), np.floor(meet + 0.5))
    shares = timer.interrupts(rate)
    after_first = n * shares - 1
    rising = np.clip(up * shares - 1, 0, after_first)
    falling = np.clip(down * shares, 0, after_first - rising)
    cruising = after_first - rising - falling
    first, cruise = timer.ticks(begin * shares), timer.ticks(rate * shares)
    climb, top = _ramp(begin, rate, a, rising, ahead * first, shares, timer, s_curve)
    lead = np.where(rising > 0, 0.0, ahead * first)
    lead = np.where(cruising > 0, ahead * cruise, lead)
    top = np.maximum(np.where(cruising > 0, rate, top), end)
    drop, _ = _ramp(top, end, a, falling, lead, shares, timer, s_curve)
    return np.asarray(timer.seconds(first) + climb + cruising * timer.seconds(cruise) + drop)


def _ramp_lengths(
    n: Array, a: Array, begin: Array, rate: Array, end: Array
) -> tuple[Array, Array, Array]:
    """Return steps (k,) of the rising and the falling ramp, and where two too long ones meet."""
    rise, fall = ((rate**2 - w**2) / (2.0 * a) for w in (begin, end))
    return rise, fall, (n + rise - fall) / 2.0


def _fitting(n: Array, up: Array, down: Array, meet: Array) -> tuple[Array, Array]:
    """Return both ramps' steps (k,) without more of them than the n of the block."""
    meet = np.clip(meet, 0.0, n)
    short = up + down > n
    return np.where(short, meet, up), np.where(short, n - meet, down)


def _ramp(
    start: Array, end: Array, a: Array, interrupts: Array, ahead: Array, shares: Array,
    timer: Timer, s_curve: bool,
) -> tuple[Array, Array]:  # fmt: skip
    """Return the seconds (k,) of ramps from start to end rates, and the rates that they reach.

    interrupts (k,): how many each ramp has; ahead (k,): ticks by which it is ahead; shares (k,):
    interrupts a step.
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
    """Return whole rates (k,) at t (k,) s: on a line, or on a Bézier curve of equal duration."""
    way = end - start
    if not s_curve:
        return np.asarray(start + np.sign(way) * np.minimum(np.floor(a * t), np.abs(way)))
    with np.errstate(divide="ignore", invalid="ignore"):
        u = np.where(way != 0.0, np.clip(a * t / np.abs(way), 0.0, 1.0), 1.0)
    return np.asarray(np.floor(start + way * (u * u * u) * (10.0 - 15.0 * u + 6.0 * u * u)))


@dataclass(frozen=True, slots=True)
class SteppedPlanner:
    """A planner whose ramps change the rate from step to step, by whole steps per second.

    development: 2.1-dev. free_entry: blocks begin at their nominal speed, as with CLASSIC_JERK
    that limits nothing. s_curve: ramps are those of S_CURVE_ACCELERATION.
    """

    block_times: BlockTimes
    timer: Timer
    development: bool = False
    free_entry: bool = False
    s_curve: bool = False

    fixed_time = False

    @property
    def stall(self) -> float:
        """Return the seconds of the first step from rest."""
        return 0.0 if self.development else 1.0 / SLOWEST

    def possible_times(self, blocks: Blocks, T: Array, before: float) -> Array:
        """Return times (k,) as near to T (k,) as blocks can last; before: see ``Player``."""
        n = blocks.n
        T = np.minimum(T, n / (1.0 if self.development else SLOWEST))
        for _ in range(ROUNDS):
            shortest = self._times(blocks, FASTEST * n / T, before)
            if (shortest <= T).all():
                break
            T = np.maximum(T, shortest)
        return T

    def feed_rates(self, blocks: Blocks, T: Array, before: float) -> Array:
        """Return speeds (k,), mm/s, at which blocks take the time T (k,)."""
        n, d, *_ = blocks
        mean, lost = n / T, 0.0
        rate, slowest, fastest = mean, mean / FASTEST, mean * FASTEST
        for _ in range(ROUNDS):  # rounding makes ramps of its own, which lose time
            for _ in range(ROUNDS):
                rate = rate * (self._times(blocks, rate, before) / (T * (1.0 - lost)))
                rate = np.minimum(np.maximum(rate, slowest), fastest)  # ramps may be too long
            whole = _dithered(rate, self.timer)
            v = (whole - 0.5) * d / n  # Marlin rounds up
            late = self._times(blocks, whole, before, v) - T
            # lateness of more than 5 % is not due to rounding, and a rate at its bound not free
            no_rate_fits = (np.abs(late) > 0.05 * T) | (rate > 0.9 * FASTEST * n / T)
            late[no_rate_fits] = 0.0
            lost = min(max(lost + float(late.sum() / T.sum()), -MOST_LOST), MOST_LOST)
        return np.asarray(v)

    def durations(self, blocks: Blocks, v: Array, before: float) -> Array:
        """Return the seconds (k,) of blocks at speeds v (k,), mm/s.

        Whether the first begins at rest is not known, nor needed.
        """
        return self._times(blocks, np.ceil(v * blocks.n / blocks.d), before, v)

    def stroke(self, blocks: Blocks, joint: Array, v: Array) -> tuple[Array, Array, Array]:
        """Return at which speeds blocks begin and end, and how long they last, (k,) each.

        v (k,): speeds asked for inside them; joint (k + 1,): at their ends, both in mm/s.
        """
        n, d, *_ = blocks
        v_s, v_e = _reachable(blocks, joint, v, self._least_entry(blocks))
        rates = v_s * n / d, np.ceil(v * n / d), v_e * n / d
        return v_s, v_e, self.block_times(blocks, *rates, self.timer, self.s_curve)

    def entry(self, blocks: Blocks, v: Array, before: float) -> Array:
        """Return the speeds (k,), mm/s, at which blocks begin; v (k,), before: see ``Player``."""
        return ramps.ends(v, blocks.corners, before, self._least_entry(blocks))[0]

    def _least_entry(self, blocks: Blocks) -> Array:
        """Return the least speeds (k,), mm/s, at which blocks begin."""
        if self.free_entry:
            return np.full(len(blocks.n), math.inf)
        return _development_entry(blocks) if self.development else np.zeros(len(blocks.n))

    def _times(self, blocks: Blocks, rate: Array, before: float, v: Array | None = None) -> Array:
        """Return the seconds (k,) of blocks at nominal rates (k,); the last ends at its own.

        v (k,): speeds whose rates these are, rounded; None: nothing is rounded, nor the timer.
        """
        n, d, *_ = blocks
        timer = UNROUNDED if v is None else self.timer
        v = rate * d / n if v is None else v
        v_s, v_e = ramps.ends(v, blocks.corners, before, self._least_entry(blocks))
        per_mm = n / d if self.development else rate / v  # releases: of the rate as it is rounded
        return self.block_times(blocks, v_s * per_mm, rate, v_e * per_mm, timer, self.s_curve)


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


def make_planner(
    generation: str, timer: Timer, classic_jerk: bool = False, s_curve: bool = False
) -> Planner:
    """Return the planner of a generation, one of GENERATIONS, in a build with these options."""
    if generation == "ft-motion":
        return FixedTimePlanner()
    if generation == "2.1-dev":
        return SteppedPlanner(times_2_1_dev, timer, development=True)
    block_times = times_2_0 if generation == "2.0" else times_2_1
    return SteppedPlanner(block_times, timer, free_entry=classic_jerk, s_curve=s_curve)


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
