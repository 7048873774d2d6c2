"""The motion that the firmware itself makes of a file as it was sliced, and how long it takes.

It accelerates at once (no limit on jerk), and has corners, accelerations and speeds of its own.
What a print has today is judged on this motion, and every print time is compared with it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import chain
from typing import Any

import numpy as np

from hframe_post.arrays import Array, Z
from hframe_post.firmware.base import FirmwareLimits
from hframe_post.native.planning import smoothed_runs
from hframe_post.planner.lookahead import Lookahead, standing
from hframe_post.planner.profiles import ProfileAtRest
from hframe_post.planner.sampling import sample
from hframe_post.planner.short_moves import ShortMoves
from hframe_post.stream.marks import Marks
from hframe_post.stream.types import (
    Handling,
    Item,
    MoveAtRest,
    Moves,
    Passthrough,
    Plan,
    Planned,
    Samples,
    StopRules,
)


class AsSliced:
    """The firmware's own plan of a file. ``seconds``: of all items that were planned.

    elsewhere: an estimate for moves from unknown places, not in them.
    """

    def __init__(self, rules: FirmwareLimits) -> None:
        self._rules = rules
        self._queue = Lookahead(rules.limits, z_share=1.0, steep=math.inf, joins=rules.joins)
        self._last: Moves | None = None  # moves before the item
        self.seconds = self.elsewhere = 0.0
        self._ratio = list[Array]()  # cruise ratios of the queued moves
        self._short = ShortMoves(rules.least, rules.step, rules.motors) if rules.least else None

    def samples(self, items: Iterable[Item]) -> Iterator[Samples]:
        """Yield the motion for all items, which is its own command."""
        planned = (each for item in chain(items, [None]) for each in self.planned(item))
        return self.sampled(planned)

    def sampled(self, planned: Iterable[Planned], size: int | None = None) -> Iterator[Samples]:
        """Yield the motion for what was planned, which is its own command."""
        for chunk in sample(planned, self._rules.limits, StopRules(), size, skip_slow=True):
            yield replace(chunk, commands={"none": chunk.xyze[:, :Z]})

    def planned(self, item: Item | None) -> Iterator[Planned]:
        """Take the next item, or None at the end; yield what is final."""
        if isinstance(item, Moves):
            self._last = item
            yield from self._moved(item, item.limits.cruise_ratio)
            return
        if isinstance(item, MoveAtRest) and self._joins(item):
            yield from self._moved(self._standing(item), 0.0)
            return
        if isinstance(item, Marks):
            if self._queue.count:
                self._queue.mark(item)
            else:
                yield item
            return
        yield from map(self._timed, self._queue.stop())
        if self._short and isinstance(item, Passthrough) and item.handling is Handling.RELEASE:
            self._short.forget()
        if isinstance(item, Passthrough) and item.cause and item.end is None:
            self.elsewhere += item.seconds
            yield item
        elif isinstance(item, Passthrough):
            self.seconds += item.seconds
            yield item
        elif item is not None:
            self.seconds += ProfileAtRest.from_move(item, self._rules.limits).trapezoid.seconds
            yield item

    def _moved(self, moves: Moves, ratio: float) -> Iterator[Plan]:
        """Add moves to the queue; yield what is final."""
        if self._short is not None:
            whole, _ = self._short.joined(moves)
            if whole is None:
                return
            moves = whole
        self._queue.add(moves)
        self._ratio.append(np.full(len(moves.line), ratio))
        while (plan := self._queue.take_final()) is not None:
            yield self._timed(plan)

    def _joins(self, move: MoveAtRest) -> bool:
        """Return whether the firmware passes a move at rest at a speed."""
        return self._queue.joins or (self._last is not None and move.start[Z] != move.end[Z])

    def _standing(self, move: MoveAtRest) -> Moves:
        """Return a move at rest as a move, with the limits of the moves before it."""
        if (before := self._last) is None:
            return standing(move, self._rules.others)
        return standing(move, before.limits, None if self._queue.joins else before)

    def _timed(self, plan: Plan) -> Plan:
        """Add the time of a plan; return it with the speeds that it reaches."""
        ratio, n, cruise = _joined(self._ratio), len(plan.line), plan.cruise
        self._ratio = [ratio[n:]]
        speed, top, seconds = smoothed_runs(
            plan.s, plan.ends, plan.speed, cruise, plan.acceleration, ratio[plan.ends[:-1]]
        )
        if (durations := self._rules.durations) is not None:
            way = np.abs(np.diff(plan.points, axis=0) @ self._rules.motors.T).max(axis=1)
            lead = np.add.reduceat(way, plan.ends[:-1])
            d = np.diff(plan.s[plan.ends])
            seconds = durations(lead, d, speed[:-1], speed[1:], cruise, plan.acceleration)
        self.seconds += float(seconds.sum())
        return Plan(
            plan.line, plan.points, plan.s, plan.ends, speed, top, plan.acceleration, plan.marks
        )


def _joined(parts: list[Any]) -> Any:
    return parts[0] if len(parts) == 1 else np.concatenate(parts)
