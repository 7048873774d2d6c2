r"""Moves → runs with final speeds: look-ahead over the whole queue at once.

       cruise     ______________
                 /              \            _________
     speed      /                \__________/         \
               /        run       |   run    |   run   \
              0                junction   feed change   0     → path length

Rules:
 1. No vertex is passed faster than its junction allows; at a stop the speed is zero.
 2. Speeds are lowered until braking and accelerating both fit: first at constant
    acceleration, where v² is linear in path length, then with the limit on jerk.
 3. A vertex that limits nothing does not end a run: the jerk-limited profile passes it at
    whatever speed and acceleration it has there.
 4. A speed is final if it is the same whether the queue ends in a stop or at full speed.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from hframe_post.arrays import Array, E, Flags, Integers, Z, lengths
from hframe_post.model.constant_acceleration import junction_deviation, junction_speeds
from hframe_post.native import kernel
from hframe_post.planner.pacing import with_travel_limits
from hframe_post.printer.settings import Limits
from hframe_post.stream.types import Handling, Item, Mark, Moves, Passthrough, Plan, Planned

BATCH = 4096  # moves planned at once; more if none of their speeds is final
LONGEST_QUEUE = 16 * BATCH
PLATEAU = 256  # moves at cruise speed in a run
# Shares of acceleration and jerk, and of the cruise speed at vertices, that keep Ruckig off the
# edge of what is feasible
FEASIBLE, BELOW_CRUISE = 1.0 - 1e-6, 1.0 - 1e-4
STEEP = 1.0  # rise over run above which a move starts and ends at rest
CREEP = 0.01  # mm/s; a junction that allows less is a stop
MELTED = 50.0  # mm/s of filament, more than any hot end melts
Z_SHARE = 1 / 3  # of z acceleration while x and y move: the firmware ramps inside segments


def plan(
    items: Iterable[Item], limits: Limits, batch: int = BATCH, longest: int = LONGEST_QUEUE
) -> Iterator[Planned]:
    """Yield the items with final speeds; the motion stops before what must happen at rest.

    batch: moves planned at once; longest: moves queued at most. Speeds may depend on both.
    """
    queue = _Queue(limits, batch, longest)
    for item in with_travel_limits(items, limits):
        if isinstance(item, Moves):
            queue.append(item)
            while (ready := queue.take_final()) is not None:
                yield ready
        elif isinstance(item, Passthrough) and item.handling is Handling.CARRY and queue.count:
            queue.mark(item.text)
        else:
            yield from queue.stop()
            yield item
    yield from queue.stop()


class _Queue:
    """Moves that are not planned yet, and the speed at which the first of them begins."""

    def __init__(self, limits: Limits, batch: int, longest: int) -> None:
        self._limits, self._batch, self._longest = limits, batch, longest
        self._moves: list[_Limited] = []
        self._marks: list[Mark] = []
        self._speed = 0.0
        self._want = self._batch
        self.count = 0

    def append(self, moves: Moves) -> None:
        self._marks += [Mark(mark.index + self.count, mark.text) for mark in moves.marks]
        self._moves.append(_limited(moves, self._limits))
        self.count += len(moves.line)

    def mark(self, text: bytes) -> None:
        self._marks.append(Mark(self.count, text))

    def take_final(self) -> Plan | None:
        """Return the final part of the first ``_want`` moves, or None if it is empty."""
        while self.count >= self._want:
            moves = _joined(self._moves)
            batch = moves.part(0, self._want)
            caps = self._caps(batch)
            stopping = _runs(batch, caps, self._limits, 0.0)
            rolling = _runs(batch, caps, self._limits, float(caps[-1]))
            final = _agreement(stopping, rolling)
            if final or self._want >= self._longest:
                s, ends, speed = stopping
                cut = final or len(ends) // 2
                self._moves = [moves.part(int(ends[cut]), len(moves.line))]
                self._want = self._batch
                return self._take(batch, s, ends[: cut + 1], speed[: cut + 1])
            self._want *= 2
        return None

    def stop(self) -> Iterator[Plan]:
        if self.count:
            moves = _joined(self._moves)
            runs = _runs(moves, self._caps(moves), self._limits, 0.0)
            self._moves, self._want = [], self._batch
            yield self._take(moves, *runs)

    def _caps(self, moves: _Limited) -> Array:
        caps = _junction_speeds(moves, self._limits.extruder_corner_velocity)
        caps[0] = self._speed
        return caps

    def _take(self, moves: _Limited, s: Array, ends: Integers, speed: Array) -> Plan:
        """Return a plan of the moves up to the last of ``ends``, where the queue begins then."""
        n = int(ends[-1])
        whole = n == self.count
        marks = tuple(mark for mark in self._marks if mark.index < n or whole)
        self._marks = [Mark(m.index - n, m.text) for m in self._marks[len(marks) :]]
        self._speed = float(speed[-1])
        self.count -= n
        _, cruise, acceleration, _ = moves.limits[ends[:-1]].T
        return Plan(
            moves.line[:n], moves.points[: n + 1], s[: n + 1],
            ends, speed, cruise, acceleration, marks,
        )  # fmt: skip


@dataclass(frozen=True, slots=True)
class _Limited:
    """Moves; their ``limits`` (n, 4) are length, cruise, acceleration and junction deviation."""

    line: Integers
    points: Array
    limits: Array

    def part(self, start: int, stop: int) -> _Limited:
        points = self.points[start : stop + 1]
        return _Limited(self.line[start:stop], points, self.limits[start:stop])


def _joined(parts: list[_Limited]) -> _Limited:
    if len(parts) == 1:
        return parts[0]
    points = [parts[0].points, *(p.points[1:] for p in parts[1:])]
    return _Limited(
        np.concatenate([p.line for p in parts]),
        np.concatenate(points),
        np.concatenate([p.limits for p in parts]),
    )


def _limited(moves: Moves, limits: Limits) -> _Limited:
    """Return the moves with the printer's limits, lowered by those of the file."""
    rules = (
        limits.velocity, limits.fastest, limits.acceleration, limits.hardest, limits.z_velocity,
        limits.extruder_velocity, MELTED, Z_SHARE * limits.z_acceleration,
        Z_SHARE * limits.extruder_acceleration, limits.square_corner_velocity,
        limits.junction_deviation,
    )  # fmt: skip
    table = np.empty((len(moves.line), 4))
    asked = moves.speed, moves.acceleration, moves.corner
    if (compiled := kernel("limit_moves")) is not None:
        of_file = *moves.limits.velocity, *moves.limits.acceleration
        compiled(moves.points, *asked, len(table), np.array([*rules, *of_file]), table)
    else:
        table.T[:] = _least_limits(moves, *rules)
    return _Limited(moves.line, moves.points, table)


def _least_limits(
    moves: Moves, velocity: float, fastest: float, accelerate: float, hardest: float,
    z_velocity: float, retract: float, melted: float, z_acceleration: float,
    e_acceleration: float, corner: float, deviation: float,
) -> tuple[Array, ...]:  # fmt: skip
    delta = np.diff(moves.points, axis=0)
    length = lengths(delta[:, :E])
    share = np.abs(delta) / length[:, None]  # of each axis in a millimetre of path
    travels = delta[:, E] == 0.0
    cruise = np.minimum(moves.speed, np.where(travels, fastest, velocity))
    acceleration = np.minimum(moves.acceleration, np.where(travels, hardest, accelerate))
    retracting = np.where(delta[:, E] < 0.0, share[:, E], 0.0)
    extruding = share[:, E] - retracting
    with np.errstate(divide="ignore"):
        for axis, asked in enumerate(moves.limits.velocity):
            if math.isfinite(asked):
                cruise = np.minimum(cruise, asked / share[:, axis])
        for axis, asked in enumerate(moves.limits.acceleration):
            if math.isfinite(asked):
                acceleration = np.minimum(acceleration, asked / share[:, axis])
        cruise = np.minimum(cruise, z_velocity / share[:, Z])
        cruise = np.minimum(cruise, retract / retracting)
        cruise = np.minimum(cruise, melted / extruding)
        by_z, by_e = z_acceleration / share[:, Z], e_acceleration / retracting
    acceleration = np.minimum(acceleration, np.minimum(by_z, by_e))
    deviations = junction_deviation(np.minimum(moves.corner, corner), acceleration)
    return length, cruise, acceleration, np.minimum(deviations, deviation)


def _junction_speeds(moves: _Limited, extruder_corner_velocity: float) -> Array:
    """Return the greatest speed at each vertex, (n + 1,), without limits at the ends."""
    if (compiled := kernel("junctions")) is not None:
        n = len(moves.line)
        caps = np.empty(n + 1)
        constants = extruder_corner_velocity, BELOW_CRUISE, STEEP, CREEP
        compiled(moves.points, moves.limits, n, *constants, caps)
        return caps
    delta = np.diff(moves.points, axis=0)
    length, cruise, acceleration, deviation = moves.limits.T
    inner = junction_speeds(delta, length, acceleration, deviation, extruder_corner_velocity)
    dx, dy, dz, _ = np.square(delta).T
    steep = dz > STEEP * STEEP * (dx + dy)
    inner[steep[:-1] | steep[1:] | (inner < CREEP)] = 0.0
    cruise = BELOW_CRUISE * cruise
    inner = np.minimum(inner, np.minimum(cruise[:-1], cruise[1:]))
    return np.concatenate([cruise[:1], inner, cruise[-1:]])


_Runs = tuple[Array, Integers, Array]


def _runs(moves: _Limited, caps: Array, limits: Limits, last: float) -> _Runs:
    """Return the path length at each vertex, which vertices end runs, and the speeds there.

    last: speed at the last vertex, mm/s.
    """
    n = len(moves.line)
    if (compiled := kernel("find_runs")) is not None:
        (s, speed), ends = np.empty((2, n + 1)), np.empty(n + 1, np.int64)
        constants = FEASIBLE * limits.jerk, limits.deceleration, last, FEASIBLE, PLATEAU
        r = compiled(moves.limits, caps, n, *constants, np.empty(8 * (n + 1)), s, ends, speed)
        return s, ends[: r + 1], speed[: r + 1]
    length, cruise, acceleration, _ = moves.limits.T
    caps2 = np.square(caps)
    caps2[-1] = last * last
    a = FEASIBLE * acceleration
    b = FEASIBLE * np.minimum(acceleration, limits.deceleration)
    s, reach2, stop2 = _summed(length), _summed(2.0 * a * length), _summed(2.0 * b * length)
    braking = np.minimum.accumulate((caps2 + stop2)[::-1])[::-1] - stop2
    v2 = np.minimum.accumulate(np.minimum(braking, caps2) - reach2) + reach2
    v2 = np.clip(v2, 0.0, caps2)
    v2[0] = caps2[0]
    rounding = 1e-15 * reach2[-1]  # of v2, whatever its size
    reached = v2 >= (1.0 - 1e-6) * caps2 - rounding
    ends = np.flatnonzero(_limiting(cruise, acceleration, caps, reached))
    speed, run, jerk = np.sqrt(v2[ends]), np.diff(s[ends]), FEASIBLE * limits.jerk
    _lower(speed, run, b[ends[:-1]], jerk, from_end=True)
    speed[0] = caps[0]  # final before, with the share of FEASIBLE to spare
    _lower(speed, run, a[ends[:-1]], jerk, from_end=False)
    return s, ends, speed


def _summed(terms: Array) -> Array:
    return np.concatenate([[0.0], np.cumsum(terms)])


def _limiting(cruise: Array, a: Array, caps: Array, reached: Flags) -> Flags:
    """Return at which vertices a run must end (rule 3); ``reached``: where the cap is reached.

    At cruise speed every PLATEAU-th vertex ends a run, so that a long way becomes final in parts.
    """
    limiting = np.ones(len(caps), dtype=bool)
    slowed = caps[1:-1] < (1.0 - 2e-4) * np.minimum(cruise[:-1], cruise[1:])
    slowed[PLATEAU - 1 :: PLATEAU] = True
    change = (cruise[:-1] != cruise[1:]) | (a[:-1] != a[1:])
    limiting[1:-1] = (slowed & reached[1:-1]) | change
    return limiting


def _lower(speed: Array, length: Array, acceleration: Array, jerk: float, from_end: bool) -> None:
    """Lower speeds to what can be reached along the whole chain from its start, or its end."""
    if from_end:
        speed, length, acceleration = speed[::-1], length[::-1], acceleration[::-1]
    active = np.arange(len(length))
    while len(active):
        top = reachable_speed(speed[active], length[active], acceleration[active], jerk)
        lower = top < speed[active + 1]
        active, top = active[lower] + 1, top[lower]
        speed[active] = top
        active = active[active < len(length)]


def reachable_speed(v0: Array, length: Array, acceleration: Array, jerk: float) -> Array:
    """Return the greatest speed reached from ``v0`` within ``length``, all (n,), mm and s.

    It starts and ends at zero acceleration. Accelerating by Δ takes T = Δ/a + a/j, or 2√(Δ/j)
    where Δ < a²/j, over (v0 + Δ/2)·T.
    """
    a, j = acceleration, jerk
    # full acceleration: Δ²/2a + Δ(v0/a + a/2j) + v0·a/j − length = 0
    b = v0 / a + a / (2.0 * j)
    c = length - v0 * a / j
    full = a * (np.sqrt(np.maximum(b * b + 2.0 * c / a, 0.0)) - b)
    # never at full acceleration: u³ + 2·v0·u − length·√j = 0 with u = √Δ
    q = length * math.sqrt(j)
    p = np.maximum(2.0 * v0, 1e-12)
    fourth = np.sqrt(np.sqrt(q))
    sixteenth = np.sqrt(np.sqrt(fourth))
    u = np.minimum(fourth * sixteenth * np.sqrt(np.sqrt(sixteenth)), q / p)  # within a half
    for _ in range(5):  # Newton's steps to the last digit, since libraries' cube roots differ
        u = (2.0 * u * u * u + q) / (3.0 * u * u + p)
    return v0 + np.where(full >= a * a / j, full, np.minimum(u * u, a * a / j))


def _agreement(one: _Runs, other: _Runs) -> int:
    """Return the index of the last run's end up to which two plans are the same; 0 for none."""
    n = min(len(one[1]), len(other[1]))
    same = (one[1][:n] == other[1][:n]) & (one[2][:n] == other[2][:n])
    return int(np.argmin(same)) - 1 if not same.all() else n - 1
