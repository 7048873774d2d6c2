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

from hframe_post.arrays import Array, Integers
from hframe_post.native.planning import STEEP, Runs, find_runs, greatest_speeds, limit_moves
from hframe_post.planner.pacing import with_travel_limits
from hframe_post.printer.settings import Limits
from hframe_post.stream.types import (
    FileLimits,
    Handling,
    Item,
    Mark,
    Moves,
    Passthrough,
    Plan,
    Planned,
)

BATCH = 4096  # moves planned at once; more if none of their speeds is final
LONGEST_QUEUE = 16 * BATCH
MELTED = 50.0  # mm/s of filament, more than any hot end melts
SHORT = 1.0  # mm; only into shorter moves must an arc fit, on a board with junction deviation
# of the accelerations in z, and in filament taken back, while x and y move: what compensation adds
# needs the rest. On a host's steps of a slice, the nozzle was off by 5 % more with all of them
Z_SHARE = 0.8


def plan(
    items: Iterable[Item], limits: Limits, batch: int = BATCH, longest: int = LONGEST_QUEUE
) -> Iterator[Planned]:
    """Yield the items with final speeds; the motion stops before what must happen at rest.

    batch: moves planned at once; longest: moves queued at most. Speeds may depend on both.
    """
    queue = Lookahead(limits, batch, longest)
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


class Lookahead:
    """Queue of moves that are not planned yet, and the speed at which the first of them begins.

    batch, longest: see ``plan``. z_share: of the z acceleration while x and y move; steep: rise
    over run above which a move starts and ends at rest.
    """

    def __init__(
        self, limits: Limits, batch: int = BATCH, longest: int = LONGEST_QUEUE,
        z_share: float = Z_SHARE, steep: float = STEEP,
    ) -> None:  # fmt: skip
        self._limits, self._batch, self._longest = limits, batch, longest
        self._z_share, self._steep = z_share, steep
        self._moves: list[_Limited] = []
        self._file_limits: FileLimits | None = None  # of the latest moves
        self._rules = np.zeros(0)
        self._marks: list[Mark] = []
        self._speed = 0.0
        self._want = self._batch
        self.count = 0

    def append(self, moves: Moves) -> None:
        self._marks += [Mark(mark.index + self.count, mark.text) for mark in moves.marks]
        if moves.limits is not self._file_limits:
            self._file_limits, self._rules = moves.limits, self._rules_with(moves.limits)
        table = limit_moves(
            moves.points, moves.speed, moves.acceleration, moves.corner, self._rules
        )
        self._moves.append(_Limited(moves.line, moves.points, table))
        self.count += len(moves.line)

    def _rules_with(self, own: FileLimits) -> Array:
        """Return the limits of the profile and of the file, as ``limit_moves`` takes them."""
        limits, z_share = self._limits, self._z_share
        velocity = min(limits.velocity, own.path)
        return np.array([
            velocity, limits.travel_velocity or velocity, limits.acceleration, limits.hardest,
            limits.z_velocity, limits.extruder_velocity, MELTED,
            z_share * limits.z_acceleration, z_share * limits.extruder_acceleration,
            limits.square_corner_velocity, min(limits.junction_deviation, own.deviation),
            *own.velocity, *own.acceleration, *own.belts[0], *own.belts[1],
        ])  # fmt: skip

    def mark(self, text: bytes) -> None:
        self._marks.append(Mark(self.count, text))

    def take_final(self) -> Plan | None:
        """Return the final part of the first ``_want`` moves, or None if it is empty."""
        while self.count >= self._want:
            moves = _joined(self._moves)
            batch = moves.part(0, self._want)
            caps = self._caps(batch)
            stopping = self._runs(batch, caps, 0.0)
            rolling = self._runs(batch, caps, float(caps[-1]))
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
            runs = self._runs(moves, self._caps(moves), 0.0)
            self._moves, self._want = [], self._batch
            yield self._take(moves, *runs)

    def _caps(self, moves: _Limited) -> Array:
        limits = self._limits
        shorter = SHORT if math.isfinite(limits.junction_deviation) else math.inf
        extruder = limits.extruder_corner_velocity
        caps = greatest_speeds(moves.points, moves.limits, extruder, shorter, self._steep)
        caps[0] = self._speed
        return caps

    def _runs(self, moves: _Limited, caps: Array, last: float) -> Runs:
        limits = self._limits
        return find_runs(moves.limits, caps, limits.jerk, limits.deceleration, last)

    def _take(self, moves: _Limited, s: Array, ends: Integers, speed: Array) -> Plan:
        """Return a plan of the moves up to the last of ``ends``, where the queue begins then."""
        n = int(ends[-1])
        whole = n == self.count
        marks = tuple(mark for mark in self._marks if mark.index < n or whole)
        self._marks = [Mark(m.index - n, m.text) for m in self._marks[len(marks) :]]
        self._speed = float(speed[-1])
        self.count -= n
        cruise, acceleration = moves.limits[ends[:-1], 1], moves.limits[ends[:-1], 2]
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


def _agreement(one: Runs, other: Runs) -> int:
    """Return the index of the last run's end up to which two plans are the same; 0 for none."""
    n = min(len(one[1]), len(other[1]))
    same = (one[1][:n] == other[1][:n]) & (one[2][:n] == other[2][:n])
    return int(np.argmin(same)) - 1 if not same.all() else n - 1
