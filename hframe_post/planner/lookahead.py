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
from dataclasses import dataclass, replace

import numpy as np

from hframe_post.arrays import Array, Integers
from hframe_post.native.planning import (
    BELOW_CRUISE,
    STEEP,
    Runs,
    find_runs,
    greatest_speeds,
    limit_moves,
)
from hframe_post.printer.settings import Limits
from hframe_post.stream.marks import NO_MARKS, Marks
from hframe_post.stream.types import (
    FileLimits,
    Item,
    MoveAtRest,
    Moves,
    Plan,
    Planned,
)

BATCH = 4096  # moves planned at once; more if none of their speeds is final
LONGEST_QUEUE = 16 * BATCH
MELTED = 50.0  # mm/s of filament, more than any hot end melts
CRUISE, ACCELERATION, ALONE = 1, 2, 4  # columns of ``limit_moves``
SHORT = 1.0  # mm; only into shorter moves must an arc fit, on a board with junction deviation
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
    for item in items:
        if isinstance(item, Marks) and queue.count:
            queue.carry(item)
        elif isinstance(item, Moves) or (isinstance(item, MoveAtRest) and queue.joins):
            queue.append(item)
            while (ready := queue.take_final()) is not None:
                yield from queue.parts(ready)
        else:
            for ready in queue.stop():
                yield from queue.parts(ready)
            yield item
    for ready in queue.stop():
        yield from queue.parts(ready)


class Lookahead:
    """Queue of moves that are not planned yet, and the speed at which the first of them begins.

    batch, longest: see ``plan``. z_share: of the z acceleration while x and y move; steep: rise
    over run above which a move starts and ends at rest. late: mm by which the firmware brakes late,
    so that it reaches corners faster than it means to. joins: whether its junctions are those of a
    board with junction deviation, which passes lifts and retractions at a speed: they are moves of
    the queue, too.
    """

    def __init__(
        self, limits: Limits, batch: int = BATCH, longest: int = LONGEST_QUEUE,
        z_share: float = Z_SHARE, steep: float = STEEP, joins: bool = False, late: float = 0.0,
    ) -> None:  # fmt: skip
        self.joins, self._late = joins, late
        self._limits, self._batch, self._longest = limits, batch, longest
        self._z_share, self._steep = z_share, steep
        self._moves: list[_Limited] = []
        self._file_limits: FileLimits | None = None  # of the latest moves
        self._rules = np.zeros(0)
        self._last: tuple[Array, Array] | None = None  # start and limits of the latest move
        self._marks = list[Marks]()
        self._standing: list[tuple[int, MoveAtRest | Marks]] = []  # by their place, for parts
        self._corners = np.zeros(0)  # mm/s at which moves begin, for parts
        self._speed = 0.0
        self._want = self._batch
        self.count = 0

    def append(self, item: Moves | MoveAtRest) -> None:
        if isinstance(item, MoveAtRest):
            self._standing.append((self.count, item))
            item = standing(item, self._file_limits or FileLimits())
        self._corners = np.append(self._corners, self.add(item))

    def add(self, moves: Moves) -> Array:
        """Add moves, in which x and y may rest; return the firmware's corner speeds before each."""
        if moves.marks:
            self._marks.append(moves.marks.shifted(self.count))
        if moves.limits is not self._file_limits:
            self._file_limits, self._rules = moves.limits, self._rules_with(moves.limits)
        table = limit_moves(
            moves.points, moves.speed, moves.acceleration, moves.corner, self._rules
        )
        corners, caps = self._caps(moves.points, table)
        self._moves.append(_Limited(moves.line, moves.points, table, caps[:-1]))
        self.count += len(moves.line)
        return corners[:-1]

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

    def mark(self, lines: Marks) -> None:
        self._marks.append(lines.moved_to(self.count))

    def carry(self, lines: Marks) -> None:
        """Add lines that do not stop the motion, to those of its parts."""
        if self._standing and self._last is not None and self._last[1][0, ALONE]:
            self._standing.append((self.count, lines))
        else:
            self.mark(lines)

    def parts(self, plan: Plan) -> Iterator[Planned]:
        """Yield the parts of a plan of this queue: motion, lifts and retractions, and their lines.

        x and y come to rest between them. A step by which motion brakes late is none of theirs.
        """
        at, n, speed = 0, len(plan.line), plan.speed
        while self._standing:
            index, item = self._standing[0]
            if index + isinstance(item, MoveAtRest) > n:
                break
            del self._standing[0]
            if index > at:
                yield _part(plan, at, index)
            at = index
            if isinstance(item, MoveAtRest):
                ends = speed[np.searchsorted(plan.ends, [index, index + 1])]
                corners = self._corners[index : index + 2]
                entry, leaving = np.minimum(ends, np.append(corners, 0.0)[:2]).tolist()
                item, at = replace(item, entry=entry, leaving=leaving), index + 1
            yield item
        if not at:
            yield plan
        elif at < n:
            yield _part(plan, at, n)
        self._standing = [(index - n, item) for index, item in self._standing]
        self._corners = self._corners[n:]

    def take_final(self) -> Plan | None:
        """Return the final part of the first ``_want`` moves, or None if it is empty."""
        while self.count >= self._want:
            moves = _joined(self._moves)
            batch = moves.part(0, self._want)
            caps = self._joints(batch)
            stopping = self._runs(batch, caps, 0.0)
            rolling = self._runs(batch, caps, float(caps[-1]))
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

    def stop(self) -> Iterator[Plan]:
        if self.count:
            moves = _joined(self._moves)
            runs = self._runs(moves, self._joints(moves), 0.0)
            self._moves, self._want, self._last = [], self._batch, None
            yield self._take(moves, *runs)

    def _separable(self, moves: _Limited, ends: Integers, count: int) -> int:
        """Return the greatest number of runs, no more than ``count``, that do not end at a stop.

        A stop may follow the last of them.
        """
        if not self.joins:
            return count
        alone, count = moves.limits[:, ALONE], min(count, len(ends) - 2)
        while count > 0 and alone[ends[count]] > alone[ends[count] - 1]:
            count -= 1
        return max(count, 0)

    def _caps(self, points: Array, table: Array) -> tuple[Array, Array]:
        """Return the firmware's corner speeds and those that count, (n + 1,) each.

        They are at the ends of moves that follow the latest.
        """
        n, own = len(table), (points, table)
        if self._last is not None:
            points, table = (np.concatenate(both) for both in zip(self._last, own, strict=True))
        self._last = points[-2:-1], table[-1:]
        extruder = self._limits.extruder_corner_velocity
        shorter = SHORT if self.joins else math.inf
        caps = greatest_speeds(points, table, self._rules, extruder, shorter, self._steep)
        raised = caps.copy()
        if self._late:
            self._brake_late(raised[1:-1], table)
        return caps[-n - 1 :], raised[-n - 1 :]

    def _brake_late(self, caps: Array, table: Array) -> None:
        """Raise the speeds (n − 1,) between moves to those that braking late leads to."""
        late = np.sqrt(np.square(caps) + 2.0 * self._late * table[1:, ACCELERATION])
        slower = BELOW_CRUISE * np.minimum(table[:-1, CRUISE], table[1:, CRUISE])
        caps[:] = np.where(caps > 0.0, np.minimum(late, slower), 0.0)

    def _joints(self, moves: _Limited) -> Array:
        """Return the greatest speeds (n + 1,) at the ends of moves; at the first, the speed."""
        caps = np.empty(len(moves.caps) + 1)
        caps[:-1], caps[-1] = moves.caps, BELOW_CRUISE * moves.limits[-1, CRUISE]
        caps[0] = self._speed
        return caps

    def _runs(self, moves: _Limited, caps: Array, last: float) -> Runs:
        limits = self._limits
        return find_runs(moves.limits, caps, limits.jerk, limits.deceleration, last)

    def _take(self, moves: _Limited, s: Array, ends: Integers, speed: Array) -> Plan:
        """Return a plan of the moves up to the last of ``ends``, where the queue begins then."""
        n = int(ends[-1])
        whole = n == self.count
        marks = Marks.joined(self._marks) if self._marks else NO_MARKS
        passed = len(marks) if whole else marks.count_before(n)
        self._marks = [marks.rows(passed).shifted(-n)] if passed < len(marks) else []
        self._speed = float(speed[-1])
        self.count -= n
        cruise, acceleration = moves.limits[ends[:-1], CRUISE : ACCELERATION + 1].T.copy()
        return Plan(
            moves.line[:n], moves.points[: n + 1], s[: n + 1],
            ends, speed, cruise, acceleration, marks.rows(0, passed) if marks else marks,
        )  # fmt: skip


@dataclass(frozen=True, slots=True)
class _Limited:
    """Moves; limits (n, 5): see ``limit_moves``; caps (n,): greatest speeds at which they begin."""

    line: Integers
    points: Array
    limits: Array
    caps: Array

    def part(self, start: int, stop: int) -> _Limited:
        points = self.points[start : stop + 1]
        own = self.limits[start:stop], self.caps[start:stop]
        return _Limited(self.line[start:stop], points, *own)


def _joined(parts: list[_Limited]) -> _Limited:
    if len(parts) == 1:
        return parts[0]
    points = [parts[0].points, *(p.points[1:] for p in parts[1:])]
    return _Limited(
        np.concatenate([p.line for p in parts]),
        np.concatenate(points),
        np.concatenate([p.limits for p in parts]),
        np.concatenate([p.caps for p in parts]),
    )


def standing(move: MoveAtRest, limits: FileLimits, like: Moves | None = None) -> Moves:
    """Return a lift or a retraction as a move. limits: of the moves around it.

    like: moves with the acceleration and the corner velocity that it has.
    """
    points, line = np.array([move.start, move.end]), np.array([move.line])
    speed, acceleration, corner = np.array([[move.speed], [move.acceleration], [math.inf]])
    if like is not None:
        acceleration, corner = like.acceleration[-1:], like.corner[-1:]
    return Moves(line, points, speed, acceleration, corner, limits)


def _part(plan: Plan, first: int, last: int) -> Plan:
    """Return moves ``first`` … ``last`` − 1 of a plan, which end where the plan does or rest."""
    a, b = np.searchsorted(plan.ends, [first, last]).tolist()
    begin = plan.marks.count_before(first + 1) if first else 0
    marks = plan.marks.rows(begin, plan.marks.count_before(last + 1)).shifted(-first)
    return Plan(
        plan.line[first:last], plan.points[first : last + 1],
        plan.s[first : last + 1] - plan.s[first], plan.ends[a : b + 1] - first,
        plan.speed[a : b + 1], plan.cruise[a:b], plan.acceleration[a:b], marks,
        rests=last < len(plan.line),
    )  # fmt: skip


def _agreement(one: Runs, other: Runs) -> int:
    """Return the index of the last run's end up to which two plans are the same; 0 for none."""
    n = min(len(one[1]), len(other[1]))
    same = (one[1][:n] == other[1][:n]) & (one[2][:n] == other[2][:n])
    return int(np.argmin(same)) - 1 if not same.all() else n - 1
