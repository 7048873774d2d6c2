"""What Marlin makes of a file: the times of the motors' steps, without a printer.

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

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from hframe_post.arrays import Array, Integers

WORD = re.compile(r"([A-Z])(-?\d*\.?\d+)?")
SLOWEST = 120
SMALL_SEGMENT = 1.0  # mm
SHALLOW = -math.sqrt(0.5)  # cosine of the angle between segments


@dataclass
class Build:
    """How a firmware was built and set up; mm, s. belt, z, e: mm per step."""

    belt: float
    z: float
    e: float
    cartesian: bool = False
    classic_jerk: bool = False
    min_steps: int = 6
    timer_hz: float = 2e6
    half_interval: bool = False  # ramps of later builds begin half an interval on
    max_velocity: list[float] = field(default_factory=lambda: [300.0, 300.0, 20.0, 60.0])
    max_acceleration: list[float] = field(default_factory=lambda: [1e4, 1e4, 500.0, 2000.0])
    acceleration: float = 3000.0
    travel_acceleration: float = 3000.0
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
    row: int
    entry: float = 0.0
    exit: float = 0.0

    @property
    def path_acceleration(self) -> float:
        return self.acceleration * self.d / self.n


@dataclass
class Run:
    """What was stepped between two moments with an empty queue; time from its first block."""

    time: Array  # (m,) of every step of the leading motor
    steps: Integers  # (m, 4): A, B, z, e after it
    start: Integers  # (4,)
    rows: Integers  # (m,): line of the file
    blocks: list[Block]

    def cells(self, t: Array) -> Integers:
        """Steps (n, 4) made at times t (n,)."""
        made = np.searchsorted(self.time, t, side="right")
        return np.where(made[:, None] > 0, self.steps[made - 1], self.start)


class Machine:
    """Follows a file; ``runs`` is filled as the queue runs empty."""

    def __init__(self, build: Build) -> None:
        self.build = build
        self.runs: list[Run] = []
        self.settings: list[str] = []  # every line that is no move
        self.merged = 0  # blocks that were not queued
        self._queue: list[Block] = []
        self._mm = [0.0, 0.0, 0.0, 0.0]  # where the file's coordinates stand
        self._at = np.zeros(4, dtype=np.int64)  # x, y, z, e in steps, as planned
        self._feed = 25.0
        self._absolute, self._absolute_e = True, True
        self._unit = np.zeros(4)
        self._last_v = 0.0
        self._last_speed = np.zeros(4)

    def read(self, text: bytes) -> list[Run]:
        for row, raw in enumerate(text.decode("latin-1").splitlines(), 1):
            line = raw.split(";")[0].strip()
            if line:
                self._line(row, line)
        self._drain()
        return self.runs

    # ------------------------------------------------------------------ lines

    def _line(self, row: int, line: str) -> None:
        command, _, rest = line.partition(" ")
        words = {k: float(v) if v else None for k, v in WORD.findall(rest)}
        if command in ("G0", "G1"):
            self._move(row, {k: v for k, v in words.items() if v is not None})
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
        elif command == "M205" and not build.classic_jerk:
            build.junction_deviation = words.get("J", build.junction_deviation)

    def _rounded(self, axis: int, value: float) -> int:
        mm = (self.build.belt, self.build.belt, self.build.z, self.build.e)[axis]
        return math.floor(float(np.float32(value)) / mm + 0.5)

    # ------------------------------------------------------------------ blocks

    def _motors(self, xyze: Integers) -> Integers:
        x, y, z, e = xyze
        return np.array([x, y, z, e] if self.build.cartesian else [x + y, x - y, z, e])

    def _move(self, row: int, words: dict[str, float]) -> None:
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
        self._plan(row, moved, delta, n)
        self._at = target

    def _plan(self, row: int, moved: Integers, delta: Integers, n: int) -> None:
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
        unit = mm / d
        block = Block(self._motors(self._at), delta, n, d, v, a, 0.0, row)
        if self._queue:
            corner = self._jerk(block, unit) if build.classic_jerk else self._corner(block, unit)
            block.corner = min(corner, v, self._last_v)
        self._unit, self._last_v = unit, v
        self._queue.append(block)

    def _corner(self, block: Block, unit: Array) -> float:
        """Junction deviation, with its bound for short segments of arcs."""
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
        v = min(block.v, self._last_v)
        jump = np.abs(unit - self._unit) * v
        shares = [m / j for m, j in zip(self.build.jerk, jump, strict=True) if j]
        return float(v * min([1.0, *shares]))

    # ------------------------------------------------------------------ stepping

    def _drain(self) -> None:
        blocks, self._queue, self._last_v = self._queue, [], 0.0
        if not blocks:
            return
        following = 0.0
        for block in reversed(blocks):
            block.exit = following
            reach = math.sqrt(block.exit**2 + 2.0 * block.path_acceleration * block.d)
            following = block.entry = min(block.corner, reach)
        for one, other in pairwise(blocks):
            reach = math.sqrt(one.entry**2 + 2.0 * one.path_acceleration * one.d)
            one.exit = other.entry = min(other.entry, reach)
        ticks = [self._ticks(block) for block in blocks]
        time = np.cumsum(np.concatenate(ticks)) / self.build.timer_hz
        steps = np.vstack([_spread(block) for block in blocks])
        rows = np.repeat([block.row for block in blocks], [block.n for block in blocks])
        self.runs.append(Run(time, steps, blocks[0].start, rows, blocks))

    def _ticks(self, block: Block) -> Array:
        """Ticks before each step of the leading motor, (n,)."""
        hz, n, a = self.build.timer_hz, block.n, block.acceleration
        nominal = math.ceil(block.v * n / block.d)
        first = max(round(nominal * block.entry / block.v), SLOWEST)
        final = max(round(nominal * block.exit / block.v), SLOWEST)
        first, final = min(first, max(nominal, SLOWEST)), min(final, max(nominal, SLOWEST))
        up = max(0, math.ceil((nominal**2 - first**2) / (2.0 * a)))
        down = max(0, math.floor((nominal**2 - final**2) / (2.0 * a)))
        if up + down > n:
            meet = (final**2 - first**2 + 2.0 * a * n) / (4.0 * a)
            up = min(max(math.ceil(meet), 0), n)
            down = n - up
        ticks = np.full(n, float(hz // nominal))
        ticks[0] = hz // first
        t = ticks[0] / 2.0 if self.build.half_interval else 0.0
        rate, beyond = float(first), 0 if self.build.half_interval else 1
        for k in range(1, min(up + beyond, n)):
            rate = min(first + a * t / hz, nominal)
            ticks[k] = hz // rate
            t += ticks[k]
        if not up:
            rate = float(nominal)
        t = 0.0
        for k in range(max(n - down + beyond, 1), n):
            now = max(rate - a * t / hz, final)
            ticks[k] = hz // now
            t += ticks[k]
        return ticks


def _spread(block: Block) -> Integers:
    """Steps (n, 4) of all motors after each step of the leading one."""
    k = np.arange(1, block.n + 1)[:, None]
    made = (2 * k * np.abs(block.delta) + block.n) // (2 * block.n)
    return np.asarray(block.start + np.sign(block.delta) * made)


def xy(cells: Integers, build: Build) -> Array:
    """mm (n, 2) at steps (n, 4)."""
    a, b = cells[:, 0], cells[:, 1]
    planar = np.stack([a, b] if build.cartesian else [(a + b) / 2.0, (a - b) / 2.0], axis=1)
    return np.asarray(planar * build.belt)
