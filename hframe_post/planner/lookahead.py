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
 5. Where firmware passes into lifts and retractions at a speed, they are moves of the queue. x and
    y then come to rest from that speed, and set out at it, as they turn in a corner.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import chain

import numpy as np

from hframe_post.arrays import Array, Integers, Z
from hframe_post.native.planning import (
    Column,
    Runs,
    find_runs,
    greatest_speeds,
    limit_moves,
)
from hframe_post.planner.parts import Limited, joined, parts
from hframe_post.printer.settings import Limits
from hframe_post.stream.marks import NO_MARKS, Marks
from hframe_post.stream.types import (
    FileLimits,
    Item,
    MoveAtRest,
    Moves,
    Passthrough,
    Plan,
    Planned,
    Standing,
)

BATCH = 4096  # moves planned at once; more if none of their speeds is final
LONGEST_QUEUE = 16 * BATCH
MELTED = 50.0  # mm/s of filament, more than any hot end melts
STEEP = 1.0  # rise over run above which a move starts and ends at rest
# of the accelerations in z, and in filament taken back, while x and y move: what compensation adds
# needs the rest. On a host's steps of a slice, the nozzle was off by 5 % more with all of them
Z_SHARE = 0.8


def plan(
    items: Iterable[Item], limits: Limits, batch: int = BATCH, longest: int = LONGEST_QUEUE,
    joins: bool = False, late: float = 0.0,
) -> Iterator[Planned]:  # fmt: skip
    """Yield the items with final speeds; the motion stops before what must happen at rest.

    batch: moves planned at once; longest: moves queued at most. Speeds may depend on both. joins,
    late: see ``Lookahead``.
    """
    queue = Lookahead(limits, batch, longest, joins=joins, late=late)
    for item in chain(items, [None]):
        for planned in queue.planned(item):
            if isinstance(planned, Plan):
                yield from parts(planned)
            else:
                yield planned


class Lookahead:
    """Queue of moves that are not planned yet, and the speed at which the first of them begins.

    Lifts and retractions are moves of the queue, too. The machine rests at those that the firmware
    makes from rest; what is between two of these is planned by itself, but many of them at once.

    batch, longest: see ``plan``. own: whether it is the firmware's own plan of a file as sliced,
    which takes all of the z acceleration while x and y move, and no rest at what is steep. late: mm
    by which the firmware brakes late, so that it reaches corners faster than it means to. joins:
    whether its junctions are those of a board with junction deviation, which passes lifts and
    retractions at a speed. others: limits of the file before its first move.
    """

    def __init__(
        self, limits: Limits, batch: int = BATCH, longest: int = LONGEST_QUEUE,
        own: bool = False, joins: bool = False, late: float = 0.0,
        others: FileLimits | None = None,
    ) -> None:  # fmt: skip
        self.joins, self._late = joins, late
        self._limits, self._batch, self._longest = limits, batch, longest
        self._z_share, self._steep = (1.0, math.inf) if own else (Z_SHARE, STEEP)
        self._new = list[Moves | MoveAtRest]()  # without limits yet
        self._moves = list[Limited]()
        self._file_limits = others or FileLimits()  # of the latest moves
        self._like = math.inf, math.inf  # their acceleration and corner
        self._last: tuple[Array, Array] | None = None  # start and limits of the latest move
        self._marks = list[Marks]()
        self._standing = list[Standing]()
        self._closed = 0  # moves until the latest at which the machine rests
        self._at_rest = False  # after the latest move
        self._speed = 0.0
        self._want = self._batch
        self.count = 0

    def planned(self, item: Item | None) -> Iterator[Plan | Passthrough | Marks]:
        """Take the next item, or None at the end; yield what is final."""
        if isinstance(item, Marks) and self.count:
            self._carry(item)
        elif isinstance(item, Moves | MoveAtRest):
            self._add(item)
            while (ready := self._take_final()) is not None:
                yield ready
        else:
            if self.count:
                self._closed = self.count
                yield self._take_closed()
                self._last = None
            if item is not None:
                yield item

    def _add(self, item: Moves | MoveAtRest) -> None:
        """Add moves, in which x and y may rest."""
        if isinstance(item, Moves):
            if item.limits is not self._file_limits:
                self._limit_new()
                self._file_limits = item.limits
            if item.marks:
                self._marks.append(item.marks.shifted(self.count))
        else:
            self._standing.append((self.count, item))
        self._new.append(item)
        self._at_rest = isinstance(item, MoveAtRest)
        self.count += len(item.line) if isinstance(item, Moves) else 1
        if self._rests(item):
            self._closed, self._want = self.count, self._batch

    def _rests(self, item: Moves | MoveAtRest) -> bool:
        """Return whether the machine is at rest before and after an item."""
        if self.joins or isinstance(item, Moves):
            return False
        return self._steep < math.inf or item.start[Z] == item.end[Z]

    def _limit_new(self) -> None:
        """Find the limits of the moves that are new, which have the same limits of the file."""
        if not self._new:
            return
        items, self._new = self._new, []
        rules = self._rules_with(self._file_limits)
        moves, rests = self._as_moves(items)
        table = limit_moves(moves.points, moves.speed, moves.acceleration, moves.corner, rules)
        table[rests, Column.ALONE] = 2.0
        corners, caps = self._caps(moves.points, table, rules)
        self._moves.append(Limited(moves.line, moves.points, table, caps, corners))

    def _as_moves(self, items: list[Moves | MoveAtRest]) -> tuple[Moves, list[int]]:
        """Return items as one, and the numbers of the moves at which the machine rests."""
        first, rests, end = items[0], list[int](), 0
        if len(items) == 1 and isinstance(first, Moves):
            self._like = first.acceleration[-1], first.corner[-1]
            return first, []
        n = sum(len(item.line) if isinstance(item, Moves) else 1 for item in items)
        points, line = np.empty((n + 1, 4)), np.empty(n, np.int64)
        speed, acceleration, corner = np.empty((3, n))
        points[0] = first.points[0] if isinstance(first, Moves) else first.start
        for item in items:
            k = end
            if isinstance(item, Moves):
                end += len(item.line)
                points[k + 1 : end + 1] = item.points[1:]
                speed[k:end], acceleration[k:end] = item.speed, item.acceleration
                corner[k:end], line[k:end] = item.corner, item.line
                self._like = item.acceleration[-1], item.corner[-1]
                continue
            end += 1
            points[end], speed[k], line[k] = item.end, item.speed, item.line
            acceleration[k], corner[k] = item.acceleration, math.inf
            if self._rests(item):
                rests.append(k)
            elif not self.joins:
                acceleration[k], corner[k] = self._like
        return Moves(line, points, speed, acceleration, corner, self._file_limits), rests

    def _rules_with(self, own: FileLimits) -> Array:
        """Return the limits of the profile and of the file, as ``limit_moves`` takes them."""
        limits, z_share = self._limits, self._z_share
        velocity = min(limits.velocity, own.path)
        return np.array([
            velocity, limits.acceleration, limits.z_velocity, limits.extruder_velocity, MELTED,
            z_share * limits.z_acceleration, z_share * limits.extruder_acceleration,
            limits.square_corner_velocity, min(limits.junction_deviation, own.deviation),
            *own.velocity, *own.acceleration, *own.belts[0], *own.belts[1],
        ])  # fmt: skip

    def _carry(self, lines: Marks) -> None:
        """Add lines that do not stop the motion, to those of its parts."""
        if self._at_rest:
            self._standing.append((self.count, lines))
        else:
            self._marks.append(lines.moved_to(self.count))

    def _take_closed(self) -> Plan:
        """Return the plan of all moves until the latest at which the machine rests."""
        moves, n = self._limited(), self._closed
        closed = moves.part(0, n)
        self._moves = [moves.part(n, len(moves.line))] if n < len(moves.line) else []
        runs = self._runs(closed, rolling=False)
        self._closed, self._want = 0, self._batch
        return self._take(closed, *runs)

    def _take_final(self) -> Plan | None:
        """Return the final part of the first ``_want`` moves, or None if it is empty."""
        while self.count >= self._want:
            if self._closed:
                return self._take_closed()
            moves = self._limited()
            batch = moves.part(0, self._want)
            stopping, rolling = (self._runs(batch, rolling) for rolling in (False, True))
            final = self._separable(batch, stopping[1], _agreement(stopping, rolling))
            if final or self._want >= self._longest:
                s, ends, speed = stopping
                half = len(ends) // 2
                cut = final or self._separable(batch, ends, half) or half
                self._moves = [moves.part(int(ends[cut]), len(moves.line))]
                self._want = self._batch
                return self._take(batch, s, ends[: cut + 1], speed[: cut + 1])
            self._want *= 2
        return None

    def _separable(self, moves: Limited, ends: Integers, count: int) -> int:
        """Return the greatest number of runs, no more than ``count``, that do not end at a stop.

        A stop may follow the last of them.
        """
        if not self.joins:
            return count
        alone, count = moves.limits[:, Column.ALONE], min(count, len(ends) - 2)
        while count > 0 and alone[ends[count]] > alone[ends[count] - 1]:
            count -= 1
        return max(count, 0)

    def _limited(self) -> Limited:
        """Return all moves of the queue with their limits."""
        self._limit_new()
        self._moves = [joined(self._moves)]
        return self._moves[0]

    def _caps(self, points: Array, table: Array, rules: Array) -> tuple[Array, Array]:
        """Return the firmware's corner speeds and those that count, (n,) each.

        They are at the beginnings of moves that follow the latest.
        """
        n, own = len(table), (points, table)
        if self._last is not None:
            points, table = (np.concatenate(both) for both in zip(self._last, own, strict=True))
        self._last = points[-2:-1], table[-1:]
        corners, caps = greatest_speeds(
            points, table, rules, self._limits.extruder_corner_velocity, self.joins, self._steep,
            self._late,
        )  # fmt: skip
        return corners[-n - 1 : -1], caps[-n - 1 : -1]

    def _runs(self, moves: Limited, rolling: bool) -> Runs:
        return find_runs(moves.limits, moves.caps, self._speed, rolling, self._limits.jerk)

    def _take(self, moves: Limited, s: Array, ends: Integers, speed: Array) -> Plan:
        """Return a plan of the moves up to the last of ``ends``, where the queue begins then."""
        n = int(ends[-1])
        whole = n == self.count
        marks = Marks.joined(self._marks) if self._marks else NO_MARKS
        passed = len(marks) if whole else marks.count_before(n)
        self._marks = [marks.rows(passed).shifted(-n)] if passed < len(marks) else []
        self._speed = float(speed[-1])
        self.count -= n
        own = moves.limits[ends[:-1], Column.CRUISE : Column.DEVIATION]
        cruise, acceleration = own.T.copy()
        return Plan(
            moves.line[:n], moves.points[: n + 1], s[: n + 1],
            ends, speed, cruise, acceleration, marks.rows(0, passed) if marks else marks,
            standing=self._taken(n, ends, speed, moves.corners),
        )  # fmt: skip

    def _taken(
        self, n: int, ends: Integers, speed: Array, corners: Array
    ) -> tuple[Standing, ...]:  # fmt: skip
        """Return what stands among the first n moves, and take it out of the queue."""
        items, k = self._standing, 0
        while k < len(items) and items[k][0] + isinstance(items[k][1], MoveAtRest) <= n:
            k += 1
        self._standing = [(index - n, item) for index, item in items[k:]]
        if not self.joins:
            return tuple(items[:k])
        corners = np.append(corners, 0.0)
        found = list[Standing]()
        for index, item in items[:k]:
            if isinstance(item, MoveAtRest):
                own = speed[np.searchsorted(ends, [index, index + 1])]
                entry, leaving = np.minimum(own, corners[index : index + 2]).tolist()
                item = replace(item, entry=entry, leaving=leaving)
            found.append((index, item))
        return tuple(found)


def _agreement(one: Runs, other: Runs) -> int:
    """Return the index of the last run's end up to which two plans are the same; 0 for none."""
    n = min(len(one[1]), len(other[1]))
    same = (one[1][:n] == other[1][:n]) & (one[2][:n] == other[2][:n])
    return int(np.argmin(same)) - 1 if not same.all() else n - 1
