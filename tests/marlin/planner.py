"""Simulation of Marlin: the times of the motors' steps for a file, without a printer.

Written from what Marlin's documentation and behaviour say of its planner, for belts A = x + y,
B = x − y (or one motor an axis). It follows a file line by line:

 1. Targets are rounded to whole steps of x, y, z, e. A block in which no motor makes
    MIN_STEPS_PER_SEGMENT steps is not queued: its steps are part of the next block.
 2. Blocks run from an entry speed over a nominal speed to an exit speed with one acceleration.
    Entry speeds are limited by the corner (junction deviation or jerk) and by what the blocks
    before and after can reach.
 3. Rates are whole steps per second, ramps whole steps, intervals whole ticks of a timer.
 4. G4, M400 and the end of the file let the queue run empty.
"""

import math
import re
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from hframe_post.arrays import Array, Integers

WORD = re.compile(r"([A-Z])(-?\d*\.?\d+)?")
SLOWEST = 120
FRAME = 1e-3  # s, of fixed-time motion
SMALL_SEGMENT = 1.0  # mm
SHALLOW = -math.sqrt(0.5)  # cosine of the angle between segments


@dataclass
class Build:
    """Build options and settings of a firmware; mm, s. belt, z, e: mm per step."""

    belt: float
    z: float
    e: float
    cartesian: bool = False
    classic_jerk: bool = False
    min_steps: int = 6
    timer_hz: float = 2e6
    planner: str = "2.1"  # 2.0, 2.1, 2.1-dev or ft-motion
    s_curve: bool = False  # S_CURVE_ACCELERATION, of 2.0 and 2.1
    extra_tick: bool = False  # the timer counts one tick more than it is set to
    smoothing_hz: float = 0.0  # of interrupts, up to which ADAPTIVE_STEP_SMOOTHING splits steps
    max_velocity: list[float] = field(default_factory=lambda: [300.0, 300.0, 20.0, 60.0])
    max_acceleration: list[float] = field(default_factory=lambda: [1e4, 1e4, 500.0, 2000.0])
    acceleration: float = 3000.0
    travel_acceleration: float = 3000.0
    retract_acceleration: float = 3000.0
    junction_deviation: float = 0.013
    jerk: list[float] = field(default_factory=lambda: [8.0, 8.0, 0.4, 5.0])


@dataclass
class Block:
    """One queued move. Speeds mm/s along it, acceleration steps/s² of the leading motor."""

    start: Integers  # steps of A, B, z, e where it begins
    delta: Integers  # (4,)
    n: int
    d: float
    v: float
    acceleration: float
    corner: float  # greatest entry speed
    least: float  # entry speed that nothing lowers
    entry: float = 0.0
    exit: float = 0.0

    @property
    def rate(self) -> float:
        """Return the nominal steps per second of the leading motor."""
        return self.v * self.n / self.d

    @property
    def path_acceleration(self) -> float:
        return self.acceleration * self.d / self.n


@dataclass
class Run:
    """Steps between two moments with an empty queue; time counts from the first block."""

    time: Array  # (m,) of every step of the leading motor
    steps: Integers  # (m, 4): A, B, z, e after it
    start: Integers  # (4,)

    @property
    def duration(self) -> float:
        return float(self.time[-1])

    @property
    def sets_out(self) -> float:
        """Return when x or y first moves."""
        return float(self.time[np.argmax((self.steps != self.start)[:, :2].any(axis=1))])

    def cells(self, t: Array) -> Integers:
        """Return the steps (n, 4) made at times t (n,)."""
        made = np.searchsorted(self.time, t, side="right")
        return np.where(made[:, None] > 0, self.steps[made - 1], self.start)


@dataclass
class FixedTimeRun:
    """Steps of fixed-time motion, looked up every FRAME, and straight between."""

    frames: Array  # (m, 4): A, B, z, e in steps, not whole

    @property
    def duration(self) -> float:
        return FRAME * (len(self.frames) - 1)

    @property
    def sets_out(self) -> float:
        """Return when x or y first moves."""
        return FRAME * int(np.argmax((self.frames != self.frames[0])[:, :2].any(axis=1)))

    def cells(self, t: Array) -> Integers:
        """Return the steps (n, 4) made at times t (n,): each in the middle between two places."""
        at = np.clip(t / FRAME, 0.0, len(self.frames) - 1.000001)
        k = at.astype(np.int64)
        part = (at - k)[:, None]
        between = (1.0 - part) * self.frames[k] + part * self.frames[k + 1]
        return np.asarray(np.floor(between + 0.5).astype(np.int64))


class Machine:
    """Machine that follows a file; it adds to ``runs`` as the queue runs empty."""

    def __init__(self, build: Build) -> None:
        self.build = build
        self.runs: list[Run | FixedTimeRun] = []
        self.settings: list[str] = []  # every line but moves
        self.merged = 0  # blocks that were not queued
        self._queue: list[Block] = []
        self._mm = [0.0, 0.0, 0.0, 0.0]  # where the file's coordinates stand
        self._at = np.zeros(4, dtype=np.int64)  # x, y, z, e in steps, as planned
        self._feed = 25.0
        self._absolute, self._absolute_e = True, True
        self._unit = np.zeros(4)
        self._last_v = self._last_safe = 0.0

    def read(self, text: bytes) -> list[Run | FixedTimeRun]:
        for raw in text.decode("latin-1").splitlines():
            line = raw.split(";")[0].strip()
            if line:
                self._line(line)
        self._drain()
        return self.runs

    # ------------------------------------------------------------------ lines

    def _line(self, line: str) -> None:
        command, _, rest = line.partition(" ")
        words = {k: float(v) if v else None for k, v in WORD.findall(rest)}
        if command in ("G0", "G1"):
            self._move({k: v for k, v in words.items() if v is not None})
            return
        self.settings.append(line)
        if command in ("G90", "G91"):
            self._absolute = self._absolute_e = command == "G90"
        elif command in ("M82", "M83"):
            self._absolute_e = command == "M82"
        elif command == "G92":
            if set(words) - {"E"}:
                self._drain()
            for axis, letter in enumerate("XYZE"):
                if (value := words.get(letter)) is not None:
                    self._mm[axis] = value
                    self._at[axis] = self._rounded(axis, value)
        elif command in ("G4", "M400", "G28"):
            self._drain()
            if command == "G28":
                self._mm[:3], self._at[:3] = [0.0, 0.0, 0.0], 0
        else:
            self._set(command, {k: v for k, v in words.items() if v is not None})

    def _set(self, command: str, words: dict[str, float]) -> None:
        build = self.build
        rows = {
            "M201": build.max_acceleration, "M203": build.max_velocity,
            "M205": build.jerk if build.classic_jerk else [],
        }  # fmt: skip
        for axis, letter in enumerate("XYZE"):
            if command in rows and rows[command] and letter in words:
                rows[command][axis] = words[letter]
        if command == "M204":
            build.acceleration = words.get("P", words.get("S", build.acceleration))
            build.travel_acceleration = words.get("T", words.get("S", build.travel_acceleration))
            build.retract_acceleration = words.get("R", build.retract_acceleration)
        elif command == "M205" and not build.classic_jerk:
            asked = words.get("J", build.junction_deviation)
            if 0.01 <= asked <= 0.3:  # it ignores others
                build.junction_deviation = asked

    def _rounded(self, axis: int, value: float) -> int:
        mm = (self.build.belt, self.build.belt, self.build.z, self.build.e)[axis]
        return math.floor(float(np.float32(value)) / mm + 0.5)

    # ------------------------------------------------------------------ blocks

    def _motors(self, xyze: Integers) -> Integers:
        x, y, z, e = xyze
        return np.array([x, y, z, e] if self.build.cartesian else [x + y, x - y, z, e])

    def _move(self, words: dict[str, float]) -> None:
        if "F" in words:
            assert words["F"] > 0.0
            self._feed = words["F"] / 60.0
        for axis, letter in enumerate("XYZE"):
            if letter in words:
                absolute = self._absolute_e if letter == "E" else self._absolute
                old = 0.0 if absolute else self._mm[axis]
                self._mm[axis] = float(np.float32(old + words[letter]))
        target = np.array([self._rounded(k, v) for k, v in enumerate(self._mm)])
        moved, delta = target - self._at, self._motors(target) - self._motors(self._at)
        n = int(np.abs(delta).max())
        if n == 0:
            return
        if n < self.build.min_steps:
            self.merged += 1
            return
        self._plan(moved, delta, n)
        self._at = target

    def _plan(self, moved: Integers, delta: Integers, n: int) -> None:
        build = self.build
        sizes = np.array([build.belt, build.belt, build.z, build.e])
        mm = moved * sizes
        standing = np.abs(delta[:3]).max() < build.min_steps
        d = abs(mm[3]) if standing else float(np.linalg.norm(mm[:3]))
        motor_mm = np.abs(delta * sizes)
        top = min(
            m * d / dm for m, dm in zip(build.max_velocity, motor_mm, strict=True) if dm > 0.0
        )
        v = min(self._feed, top)
        asked = build.acceleration if delta[3] else build.travel_acceleration
        limits = np.array(build.max_acceleration) / sizes
        a = asked * n / d
        a = min([a, *(limits[k] * n / abs(delta[k]) for k in range(4) if delta[k])])
        if not delta[:3].any():  # a retraction has an acceleration of its own
            a = build.retract_acceleration * n / d
        block = Block(self._motors(self._at), delta, n, d, v, a, 0.0, 0.0)
        if build.planner in ("2.1-dev", "ft-motion"):  # the mean speed of a first step from rest
            block.least = min(math.sqrt(a / 2.0) * d / n, v)
        way = delta * sizes  # of the motors, e too
        unit = way / (d if build.classic_jerk else np.linalg.norm(way))
        if build.classic_jerk:
            block.corner = max(self._jerk(block, unit), block.least)
        elif self._queue:
            block.corner = max(min(self._corner(block, unit), v, self._last_v), block.least)
        else:
            block.corner = block.least
        self._unit, self._last_v = unit, v
        self._queue.append(block)

    def _corner(self, block: Block, unit: Array) -> float:
        """Limit by junction deviation, with its bound for short segments of arcs."""
        cosine = -float(self._unit @ unit)
        if cosine > 0.999999:
            return 0.0
        cosine = max(cosine, -0.999999)
        change = unit - self._unit
        size = float(np.linalg.norm(change))
        limit = block.path_acceleration
        if size > 0.0:
            for most, part in zip(self.build.max_acceleration, change / size, strict=True):
                if abs(part) * limit > most:
                    limit = most / abs(part)
        sin_half = math.sqrt(0.5 * (1.0 - cosine))
        v2 = limit * self.build.junction_deviation * sin_half / (1.0 - sin_half)
        if block.d < SMALL_SEGMENT and cosine < SHALLOW:
            v2 = min(v2, block.d * limit / max(math.acos(-cosine), 1e-9))
        return math.sqrt(v2)

    def _jerk(self, block: Block, unit: Array) -> float:
        """Limit sudden changes of speed, axis by axis.

        Before the development branch, blocks whose speed may be taken up from a standstill, and
        given up to one, begin at their own speed whatever that of the one before.
        """
        v = min(block.v, self._last_v) if self._queue else block.v
        safe = block.v * self._share(unit * block.v)
        released = self.build.planner in ("2.0", "2.1")
        leaving, entering = self._unit * v, unit * (block.v if released else v)
        jump = np.abs(entering - leaving)
        if released:  # a reversal is no more than the greater of the two
            apart = leaving * entering < 0.0
            jump = np.where(apart, np.maximum(np.abs(leaving), np.abs(entering)), jump)
        passed = v * (self._share(jump) if self._queue else 1.0)
        both = min(safe, self._last_safe if self._queue else safe)
        self._last_safe = safe
        return safe if released and (both > 0.99 * passed or not self._queue) else passed

    def _share(self, jump: Array) -> float:
        shares = [m / abs(j) for m, j in zip(self.build.jerk, jump, strict=True) if j]
        return float(min([1.0, *shares]))

    # ------------------------------------------------------------------ look-ahead

    def _drain(self) -> None:
        blocks, self._queue, self._last_v = self._queue, [], 0.0
        if not blocks:
            return
        following = blocks[-1].least
        for block in reversed(blocks):
            block.exit = following
            reach = math.sqrt(block.exit**2 + 2.0 * block.path_acceleration * block.d)
            following = block.entry = max(min(block.corner, reach), block.least)
        for one, other in pairwise(blocks):
            reach = math.sqrt(one.entry**2 + 2.0 * one.path_acceleration * one.d)
            one.exit = other.entry = max(min(other.entry, reach), other.least)
        if self.build.planner == "ft-motion":
            self.runs.append(fixed_time(blocks))
            return
        stepper = development if self.build.planner == "2.1-dev" else released
        ticks = [stepper(block, self.build) for block in blocks]
        time = np.cumsum(np.concatenate(ticks)) / self.build.timer_hz
        steps = np.vstack([_spread(block) for block in blocks])
        self.runs.append(Run(time, steps, blocks[0].start))


# ---------------------------------------------------------------------- stepping


class _Timer:
    """Intervals of steps in ticks. Smoothing splits a step into 2, 4, 8 … while the timer can."""

    def __init__(self, build: Build, nominal: int) -> None:
        self.hz, self.extra = build.timer_hz, int(build.extra_tick)
        self.shift = 0
        while nominal << (self.shift + 1) < build.smoothing_hz:
            self.shift += 1

    def ticks(self, rate: int) -> int:
        return int(self.hz // (rate << self.shift))

    def taken(self, counted: Array) -> Array:
        """Return the ticks (n,) of whole steps, of which the parts were counted (n << shift,)."""
        return np.asarray((counted + self.extra).reshape(-1, 1 << self.shift).sum(axis=1))


def released(block: Block, build: Build) -> Array:
    """Return the ticks (n,) of the steps, as 2.0.9 and 2.1.2 have them.

    Rates are at least 120 steps a second. Ramps: rising through step ``up``, falling after
    ``n − down``. 2.1 counts the first step into the time of the ramp, 2.0 does not.
    """
    a, n = block.acceleration, block.n
    nominal = math.ceil(block.rate)
    first = max(math.ceil(nominal * block.entry / block.v - 1e-6), SLOWEST)
    final = max(math.ceil(nominal * block.exit / block.v - 1e-6), SLOWEST)
    up = max(0, math.ceil((nominal**2 - first**2) / (2.0 * a)))
    down = max(0, math.floor((nominal**2 - final**2) / (2.0 * a)))
    if up + down > n:
        meet = math.ceil((n + (final**2 - first**2) / (2.0 * a)) / 2.0)
        up = min(max(meet, 0), n)
        down = n - up
    timer = _Timer(build, nominal)
    scale = 1 << timer.shift
    counted = np.empty(n * scale)
    counted[0] = timer.ticks(first)
    rising, falling = (counted[0] if build.planner == "2.1" else 0.0), 0.0
    reached = first
    plateau = n - up - down > 0
    top = nominal if plateau or not build.s_curve else min(int(_reach(first, a, up)), nominal)
    for k in range(1, n * scale):
        if k <= up * scale and build.s_curve:
            reached = _curve(first, top, a, rising / build.timer_hz)
            counted[k] = timer.ticks(reached)
            rising += counted[k]
        elif k > (n - down) * scale and build.s_curve:
            counted[k] = timer.ticks(_curve(top, final, a, falling / build.timer_hz))
            falling += counted[k]
        elif k <= up * scale:
            reached = min(first + int(a * rising / build.timer_hz), nominal)
            counted[k] = timer.ticks(reached)
            rising += counted[k]
        elif k > (n - down) * scale:
            counted[k] = timer.ticks(max(reached - int(a * falling / build.timer_hz), final))
            falling += counted[k]
        else:
            counted[k] = timer.ticks(nominal)
    return timer.taken(counted)


def _reach(rate: float, a: float, steps: int) -> float:
    return math.sqrt(rate**2 + 2.0 * a * steps)


def _curve(start: int, end: int, a: float, t: float) -> int:
    """Return the rate on the Bézier curve of sixth order that lasts as long as a line would."""
    u = min(a * t / abs(end - start), 1.0) if end != start else 1.0
    return int(start + (end - start) * (u**3 * (10.0 - 15.0 * u + 6.0 * u**2)))


def development(block: Block, build: Build) -> Array:
    """Return the ticks (n,) of the steps, as the development branch has them since the end of 2024.

    Both ramps begin half an interval on; falling takes whole steps rounded up.
    """
    a, n = block.acceleration, block.n
    nominal = math.ceil(block.rate)
    first, final = (max(math.floor(v * n / block.d + 0.5), 1) for v in (block.entry, block.exit))
    rise, fall = ((nominal**2 - rate**2) / (2.0 * a) for rate in (first, final))
    up, down = math.ceil(rise), math.ceil(fall)
    if up + down > n:
        up = min(max(math.floor((n + rise - fall + 1.0) / 2.0), 0), n)
        down = n - up
    timer = _Timer(build, nominal)
    scale = 1 << timer.shift
    counted = np.empty(n * scale)
    counted[0] = timer.ticks(first)
    rising = falling = counted[0] // 2
    reached, cruised = first, False
    for k in range(1, n * scale):
        if k < up * scale:
            reached = min(first + int(a * rising / build.timer_hz), nominal)
            counted[k] = timer.ticks(reached)
            rising, falling = rising + counted[k], 0.0
        elif k >= (n - down) * scale:
            counted[k] = timer.ticks(max(reached - int(a * falling / build.timer_hz), final))
            falling += counted[k]
        else:
            counted[k] = timer.ticks(nominal)
            if not cruised:
                reached, cruised, falling = nominal, True, counted[k] // 2
    return timer.taken(counted)


def _spread(block: Block) -> Integers:
    """Return the steps (n, 4) of all motors after each step of the leading one."""
    k = np.arange(1, block.n + 1)[:, None]
    made = (2 * k * np.abs(block.delta) + block.n) // (2 * block.n)
    return np.asarray(block.start + np.sign(block.delta) * made)


def fixed_time(blocks: list[Block]) -> FixedTimeRun:
    """Return exact trapezoids in time, looked up every millisecond.

    A block that is to end faster than it can run overshoots, as the real one does.
    """
    durations, shares = [], []
    for block in blocks:
        a, v_s, v_e = block.path_acceleration, block.entry, block.exit
        v = min(block.v, math.sqrt(a * block.d + (v_s**2 + v_e**2) / 2.0))
        up, down = (v - v_s) / a, (v - v_e) / a
        cruise = max(block.d - (v * v - v_s**2) / (2.0 * a) - (v * v - v_e**2) / (2.0 * a), 0.0) / v
        durations.append(up + cruise + down)
        shares.append((a, v_s, v, up, cruise, down))
    ends = np.cumsum(durations)
    t = FRAME * np.arange(1, math.ceil(ends[-1] / FRAME) + 1)
    which = np.minimum(np.searchsorted(ends, t), len(blocks) - 1)
    tau = np.minimum(t - (ends - durations)[which], np.array(durations)[which])
    a, v_s, v, up, cruise, down = np.array(shares)[which].T
    rising, falling = np.minimum(tau, up), np.maximum(tau - up - cruise, 0.0)
    s = v_s * rising + a * rising**2 / 2.0 + v * np.clip(tau - up, 0.0, cruise)
    s += v * falling - a * falling**2 / 2.0
    start, delta = (
        np.array([getattr(b, name) for b in blocks])[which] for name in ("start", "delta")
    )
    d = np.array([b.d for b in blocks])[which]
    frames = np.vstack([blocks[0].start, start + delta * np.maximum(s / d, 0.0)[:, None]])
    return FixedTimeRun(frames)


def xy(cells: Integers, build: Build) -> Array:
    """Return x and y (n, 2) in mm at steps (n, 4)."""
    a, b = cells[:, 0], cells[:, 1]
    planar = np.stack([a, b] if build.cartesian else [(a + b) / 2.0, (a - b) / 2.0], axis=1)
    return np.asarray(planar * build.belt)
