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

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from hframe_post.arrays import Array, Integers
from hframe_post.native import kernels
from hframe_post.native.whole_steps import Blocks

SLOWEST = 120.0  # steps/s, before the development branch
FASTEST = 3.0  # times a block's mean rate, the most that is asked for to make up for its ramps
ROUNDS = 3  # of the rates' dependence on their neighbours'


@dataclass(frozen=True, slots=True)
class Timer:
    """Timer of the steppers.

    extra_tick: it counts one tick more than it is set to. smoothing_hz: interrupts a second up to
    which ADAPTIVE_STEP_SMOOTHING makes 2, 4, 8 … of each step; 0: it is off.
    """

    hz: float
    extra_tick: bool = False
    smoothing_hz: float = 0.0

    def interrupts(self, rate: Array) -> Array:
        """Return the interrupts a step, (k,), in blocks of nominal rates (k,)."""
        if not self.smoothing_hz:
            return np.ones(len(rate))
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


@dataclass(frozen=True)
class Stepper:
    """The stepper interrupt of a build.

    ahead: share of the first interval by which a rising ramp is ahead. development: 2.1-dev.
    s_curve: ramps are those of S_CURVE_ACCELERATION. False for 2.1-dev: its profile is refused.
    """

    timer: Timer
    ahead: float
    development: bool = False
    s_curve: bool = False

    @cached_property
    def row(self) -> Array:
        """Return it as the compiled loops take it, (7,)."""
        t = self.timer
        own = self.ahead, self.development, self.s_curve
        return np.array([t.hz, t.extra_tick, t.smoothing_hz, *own, SLOWEST])

    @cached_property
    def unrounded(self) -> Stepper:
        return replace(self, timer=UNROUNDED)


def block_times(blocks: Blocks, begin: Array, rate: Array, end: Array, stepper: Stepper) -> Array:
    """Return the seconds (k,) of blocks from the rates (k,) at which they begin, run and end."""
    k, taken = len(rate), np.empty(len(rate))
    kernels.marlin_block_times(k, blocks.n, blocks.a, begin, rate, end, stepper.row, taken)
    return taken


class _Interrupts(NamedTuple):
    """Ticks of the interrupts of all blocks (m,); the index of each block's first, and past it."""

    ticks: Array
    first: Integers
    past: Integers


def step_times(blocks: Blocks, begin: Array, rate: Array, end: Array, stepper: Stepper) -> Array:
    """Return when each step of all blocks is made, (m,), in seconds from the start of the first.

    The arguments are those of ``block_times``.
    """
    timer = stepper.timer
    shares = timer.interrupts(rate)
    own = (blocks.n * shares).astype(np.int64)
    past = np.cumsum(own)
    made = _Interrupts(np.repeat(timer.ticks(rate * shares), own), past - own, past)
    found = _development_times if stepper.development else _released_times
    found(blocks, begin, rate, end, stepper, made)
    whole = np.cumsum(np.repeat(shares, blocks.n.astype(np.int64))).astype(np.int64) - 1
    total = np.cumsum(made.ticks + float(timer.extra_tick))
    return np.asarray(total[whole] / timer.hz)


def _released_times(
    blocks: Blocks, begin: Array, rate: Array, end: Array, stepper: Stepper,
    made: _Interrupts,
) -> Array:  # fmt: skip
    """Return block times of 2.0 and 2.1, and write the ramps' interrupts to ``made``."""
    n, _, a, _ = blocks
    timer, s_curve = stepper.timer, stepper.s_curve
    begin, end = (np.minimum(np.maximum(np.ceil(w - 1e-6), SLOWEST), rate) for w in (begin, end))
    rise, fall, meet = _ramp_lengths(n, a, begin, rate, end)
    up, down = _fitting(n, np.ceil(rise), np.floor(fall), np.ceil(meet))
    shares = timer.interrupts(rate)
    after_first = n * shares - 1.0
    rising = _between(up * shares, after_first)
    falling = _between(down * shares - 1.0, after_first - rising)
    cruising = after_first - rising - falling
    first, cruise = timer.ticks(begin * shares), timer.ticks(rate * shares)
    reach = rate
    if s_curve:  # a curve must know where it will end
        met = np.minimum(np.sqrt(begin**2 + 2.0 * a * up), rate)
        reach = np.where(n - up - down > 0.0, rate, met)
    up_to, down_to = _places(made, first, falling)
    climb, top = _ramp(begin, reach, a, rising, stepper.ahead * first, shares, stepper, up_to)
    top = np.maximum(reach if s_curve else top, end)
    drop, _ = _ramp(top, end, a, falling, np.zeros(len(n)), shares, stepper, down_to)
    return np.asarray(timer.seconds(first) + climb + cruising * timer.seconds(cruise) + drop)


def _development_times(
    blocks: Blocks, begin: Array, rate: Array, end: Array, stepper: Stepper,
    made: _Interrupts,
) -> Array:  # fmt: skip
    """Return block times of 2.1-dev, whose ramps are ahead by half an interval.

    They are an interval shorter at the top than before, and an interval longer at the foot.
    """
    n, _, a, _ = blocks
    timer, ahead = stepper.timer, stepper.ahead
    # Marlin rounds halves up
    begin, end = (np.minimum(np.maximum(np.floor(w + 0.5), 1.0), rate) for w in (begin, end))
    rise, fall, meet = _ramp_lengths(n, a, begin, rate, end)
    up, down = _fitting(n, np.ceil(rise), np.ceil(fall), np.floor(meet + 0.5))
    shares = timer.interrupts(rate)
    after_first = n * shares - 1.0
    rising = _between(up * shares - 1.0, after_first)
    falling = _between(down * shares, after_first - rising)
    cruising = after_first - rising - falling
    first, cruise = timer.ticks(begin * shares), timer.ticks(rate * shares)
    up_to, down_to = _places(made, first, falling)
    climb, top = _ramp(begin, rate, a, rising, ahead * first, shares, stepper, up_to)
    lead = np.where(rising > 0, 0.0, ahead * first)
    lead = np.where(cruising > 0, ahead * cruise, lead)
    top = np.maximum(np.where(cruising > 0, rate, top), end)
    drop, _ = _ramp(top, end, a, falling, lead, shares, stepper, down_to)
    return np.asarray(timer.seconds(first) + climb + cruising * timer.seconds(cruise) + drop)


def _places(made: _Interrupts, first: Array, falling: Array) -> tuple[_Interrupts, _Interrupts]:
    """Write the first ticks (k,) of blocks; return where both ramps write theirs."""
    made.ticks[made.first] = first
    return (
        made._replace(first=made.first + 1),
        made._replace(first=made.past - falling.astype(np.int64)),
    )


def _ramp_lengths(
    n: Array, a: Array, begin: Array, rate: Array, end: Array
) -> tuple[Array, Array, Array]:
    """Return steps (k,) of the rising and the falling ramp, and where two too long ones meet."""
    rise, fall = ((rate**2 - w**2) / (2.0 * a) for w in (begin, end))
    return rise, fall, (n + (rise - fall)) / 2.0  # exactly the middle if they are alike


def _fitting(n: Array, up: Array, down: Array, meet: Array) -> tuple[Array, Array]:
    """Return both ramps' steps (k,) without more of them than the n of the block."""
    meet = _between(meet, n)
    short = up + down > n
    return np.where(short, meet, up), np.where(short, n - meet, down)


def _between(x: Array, most: Array) -> Array:
    return np.minimum(np.maximum(x, 0.0), most)  # np.clip takes twice as long


def _ramp(
    start: Array, end: Array, a: Array, interrupts: Array, ahead: Array, shares: Array,
    stepper: Stepper, made: _Interrupts,
) -> tuple[Array, Array]:  # fmt: skip
    """Return the seconds (k,) of ramps from start to end rates, and the rates that they reach.

    interrupts (k,): how many each ramp has; ahead (k,): ticks by which it is ahead; shares (k,):
    interrupts a step.
    """
    timer = stepper.timer
    taken, t, now, done = np.zeros(len(start)), ahead / timer.hz, start.copy(), 0
    while (ramping := interrupts > done).any():
        now = np.where(ramping, _rate_at(t, start, end, a, stepper.s_curve), now)
        ticks = timer.ticks(now * shares)
        made.ticks[made.first[ramping] + done] = ticks[ramping]
        taken = np.where(ramping, taken + timer.seconds(ticks), taken)
        t = t + ticks / timer.hz
        done += 1
    return taken, now


def _rate_at(t: Array, start: Array, end: Array, a: Array, s_curve: bool) -> Array:
    """Return whole rates (k,) at t (k,) s: on a line, or on a Bézier curve of equal duration."""
    way = end - start
    if not s_curve:
        return np.asarray(start + np.sign(way) * np.minimum(np.floor(a * t), np.abs(way)))
    with np.errstate(divide="ignore", invalid="ignore"):
        u = np.where(way != 0.0, np.clip(a * t / np.abs(way), 0.0, 1.0), 1.0)
    return np.asarray(np.floor(start + way * (u * u * u) * (10.0 - 15.0 * u + 6.0 * u * u)))


def joined_times(
    blocks: Blocks, v: Array, rate: Array, before: float, free_entry: bool, stepper: Stepper
) -> Array:
    """Return the seconds (k,) of successive blocks at speeds v (k,) and their rates, as rounded.

    before: speed of the block that precedes; free_entry: they begin at their own speed, if their
    corners allow it. The last ends at its own speed.
    """
    n, d, a, corners = blocks
    k, taken, own = len(v), np.empty(len(v)), (before, free_entry, stepper.row)
    kernels.marlin_times(k, n, d, a, _at_ends(corners, k), v, rate, *own, taken)
    return taken


def least_entry(blocks: Blocks, free_entry: bool, development: bool) -> Array:
    """Return the least speeds (k,), mm/s, at which blocks begin."""
    if development:
        return np.sqrt(blocks.a / 2.0) * blocks.d / blocks.n
    return np.full(len(blocks.n), math.inf if free_entry else 0.0)


def feed_rates(
    blocks: Blocks, T: Array, before: float, free_entry: bool, stepper: Stepper
) -> Array:
    """Return speeds (k,), mm/s, at which blocks take the time T (k,); see ``joined_times``."""
    n, d, a, corners = blocks
    k, v, room = len(T), np.empty(len(T)), np.empty(3 * len(T))
    own = before, free_entry, stepper.row
    kernels.marlin_feed_rates(k, n, d, a, _at_ends(corners, k), T, *own, ROUNDS, FASTEST, room, v)
    return v


def _at_ends(corners: Array | float, k: int) -> Array:
    return np.full(k + 1, corners)
