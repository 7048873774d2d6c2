"""The motion that the firmware itself makes of a file as it was sliced, and how long it takes.

It accelerates at once (no limit on jerk), and has corners, accelerations and speeds of its own.
What a print has today is judged on this motion, and every print time is compared with it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import chain
from typing import Any

import numpy as np

from hframe_post.arrays import Array, E, Flags, Integers, Z
from hframe_post.firmware.base import FirmwareLimits
from hframe_post.native import ramps
from hframe_post.native.planning import smoothed_runs
from hframe_post.planner.lookahead import Lookahead
from hframe_post.planner.parts import parts
from hframe_post.planner.sampling import sample
from hframe_post.stream.marks import NO_MARKS, Marks
from hframe_post.stream.types import (
    Handling,
    Item,
    MoveAtRest,
    Moves,
    Passthrough,
    Plan,
    Position,
    Samples,
    StopRules,
    frozen,
)

NO_RATIO = np.zeros(1)  # of a lift or a retraction
Timed = tuple[Plan, Array]  # with the speeds that it reaches; seconds of each run in motion


class AsSliced:
    """The firmware's own plan of a file. ``seconds``: of all items that were planned.

    elsewhere: an estimate for moves from unknown places, not in them.
    """

    def __init__(self, rules: FirmwareLimits) -> None:
        self._rules = rules
        self._queue = Lookahead(rules.limits, own=True, joins=rules.joins, others=rules.others)
        self.seconds = self.elsewhere = 0.0
        self._ratio = list[Array]()  # cruise ratios of the queued moves
        self._short = ShortMoves(rules.least, rules.step, rules.motors) if rules.least else None

    def samples(self, items: Iterable[Item]) -> Iterator[Samples]:
        """Yield the motion for all items, which is its own command."""
        timed = (each for item in chain(items, [None]) for each in self.timed(item))
        return self.sampled(each[0] if isinstance(each, tuple) else each for each in timed)

    def sampled(
        self, planned: Iterable[Plan | Passthrough | Marks], size: int | None = None
    ) -> Iterator[Samples]:
        """Yield the motion for what was planned, which is its own command."""
        separate = (
            each
            for item in planned
            for each in (parts(item) if isinstance(item, Plan) else (item,))
        )
        for chunk in sample(separate, self._rules.limits, StopRules(), size, skip_slow=True):
            yield replace(chunk, commands={"none": chunk.xyze[:, :Z]})

    def timed(self, item: Item | None) -> Iterator[Timed | Passthrough | Marks]:
        """Take the next item, or None at the end; yield what is final."""
        if isinstance(item, Moves | MoveAtRest):
            if self._short and (item := self._short.joined(item)) is None:
                return
            ratio = NO_RATIO
            if isinstance(item, Moves):
                ratio = np.full(len(item.line), item.limits.cruise_ratio)
            self._ratio.append(ratio)
        elif isinstance(item, Passthrough):
            self._note(item)
        for planned in self._queue.planned(item):
            yield self._timed(planned) if isinstance(planned, Plan) else planned

    def _note(self, item: Passthrough) -> None:
        if item.cause and item.end is None:
            self.elsewhere += item.seconds
        else:
            self.seconds += item.seconds
        if self._short and item.handling is Handling.RELEASE:
            self._short.forget()

    def _timed(self, plan: Plan) -> Timed:
        """Add the time of a plan; return it with the speeds that it reaches."""
        ratio, n, cruise = _joined(self._ratio), len(plan.line), plan.cruise
        self._ratio = [ratio[n:]]
        first, most = plan.ends[:-1], plan.acceleration
        speed, top, seconds = smoothed_runs(
            plan.s, plan.ends, plan.speed, cruise, most, ratio[first]
        )
        d = np.diff(plan.s[plan.ends])
        if (durations := self._rules.durations) is not None:
            way = np.abs(np.diff(plan.points, axis=0) @ self._rules.motors.T).max(axis=1)
            lead, runs = np.add.reduceat(way, first), d > 0.0
            of_runs = (each[runs] for each in (lead, d, speed[:-1], speed[1:], cruise, most))
            seconds[runs] = durations(*of_runs)
        rests = d <= 0.0
        self.seconds += float(seconds.sum()) + self._at_rest(plan, first[rests], rests)
        return replace(plan, speed=speed, cruise=top), seconds

    @staticmethod
    def _at_rest(plan: Plan, moves: Integers, rests: Flags) -> float:
        """Return the seconds of moves, all from rest to rest, in which only z or e changes."""
        z, e = np.abs(plan.points[moves + 1, Z:] - plan.points[moves, Z:]).T
        length, a = np.where(z > 0.0, z, e), plan.acceleration[rests]
        peak = np.minimum(plan.cruise[rests], np.sqrt(length * a))
        return float(ramps.seconds(length, peak, 0.0, 0.0, a).sum())


def _joined(parts: list[Any]) -> Any:
    return parts[0] if len(parts) == 1 else np.concatenate(parts)


# ----------------------------------------------------------------------
# Moves that a firmware joins because they have too few steps, as Marlin does.
#
# The next move sets out from where the last one ended that was long enough, at its own speed.


class ShortMoves:
    """Joins successive moves.

    least: steps of the shortest move; step: mm of x, y, z and e; motors (4, 4): from mm to steps of
    the motors.
    """

    def __init__(self, least: int, step: Position, motors: Array) -> None:
        self._least, self._step, self._motors = least, np.array(step), motors
        self._origin: Array | None = None  # where the last move ended that is long enough, mm

    def forget(self) -> None:
        """Begin again at a place that the file sets."""
        self._origin = None

    def joined(self, item: Moves | MoveAtRest) -> Moves | MoveAtRest | None:
        """Return the moves in whole steps that are long enough, if any are left."""
        points = item.points if isinstance(item, Moves) else np.array([item.start, item.end])
        points = np.rint(points / self._step) * self._step
        if self._origin is not None:
            points[0] = self._origin
        kept = self._kept(points)
        self._origin = points[1:][kept][-1] if kept.any() else points[0]
        if not kept.any():
            return None
        if not isinstance(item, MoveAtRest):
            return _among(item, points, kept)
        start, end = (_position(place) for place in points.tolist())
        return replace(item, start=start, end=end)

    def joined_travel(self, items: Iterable[Item]) -> Iterator[Item]:
        """Yield the items; where travel has a short move, the next move of it begins there."""
        for item in items:
            if isinstance(item, Moves):
                kept = self._kept(item.points)
                travels = item.points[1:, E] == item.points[:-1, E]
                kept[-1], kept[:-1] = True, kept[:-1] | ~(travels[:-1] & travels[1:])
                item = item if kept.all() else _among(item, item.points, kept)
            yield item

    def _kept(self, points: Array) -> Flags:
        """Return which moves between points (n + 1, 4) are long enough, (n,)."""
        places = points @ self._motors.T
        n, least = len(places) - 1, self._least - 0.5
        kept = np.ones(n, dtype=bool)
        done = 0
        for k in np.flatnonzero(np.abs(np.diff(places, axis=0)).max(axis=1) < least).tolist():
            if k < done:
                continue
            done = k
            while done < n and np.abs(places[done + 1] - places[k]).max() < least:
                kept[done] = False
                done += 1
            done += 1
        return kept


def _position(place: list[float]) -> Position:
    x, y, z, e = place
    return x, y, z, e


def _among(moves: Moves, points: Array, kept: Flags) -> Moves:
    """Return the moves that are kept, (n,), of those between points (n + 1, 4)."""
    places = np.concatenate([points[:1], points[1:][kept]])
    before = np.append(0, np.cumsum(kept))
    marks = moves.marks.moved_to(before[moves.marks.at]) if moves.marks else NO_MARKS
    speed, acceleration, corner = (
        frozen(each[kept]) for each in (moves.speed, moves.acceleration, moves.corner)
    )
    line, limits = moves.line[kept], moves.limits
    return Moves(line, frozen(places), speed, acceleration, corner, limits, marks)
