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

from hframe_post.arrays import Array, E, Flags, Z, lengths
from hframe_post.firmware.base import FirmwareLimits
from hframe_post.native.planning import smoothed_runs
from hframe_post.planner.bands import MotorBands, OuterWalls, TimeInBands
from hframe_post.planner.lookahead import Lookahead
from hframe_post.planner.profiles import ProfileAtRest
from hframe_post.planner.sampling import sample
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
    in_bands: the outer walls' time, and what of it a motor spends in these bands.
    """

    def __init__(self, rules: FirmwareLimits, bands: MotorBands | None = None) -> None:
        self._rules = rules
        self._queue = Lookahead(rules.limits, z_share=1.0, steep=math.inf)
        self._last: Moves | None = None  # moves before the item
        self.seconds = self.elsewhere = 0.0
        self._bands, self._walls, self.in_bands = bands, OuterWalls(), TimeInBands()
        self._outer = list[Flags]()  # which of the queued moves are outer walls
        self._ratio = list[Array]()  # cruise ratios of the queued moves

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
        if self._bands is not None:
            if isinstance(item, Moves):
                self._outer.append(self._walls.among(item))
            elif item is not None:
                self._walls.pass_by(item)
        if isinstance(item, Moves):
            ratio, self._last = item.limits.cruise_ratio, item
        elif isinstance(item, MoveAtRest) and self._last and _lifts(item):
            ratio, item = 0.0, self._lift(item, self._last)
        if isinstance(item, Moves):
            self._queue.append(item)
            self._ratio.append(np.full(len(item.line), ratio))
            while (plan := self._queue.take_final()) is not None:
                yield self._timed(plan)
            return
        if isinstance(item, Passthrough) and item.handling is Handling.CARRY:
            if self._queue.count:
                self._queue.mark(item.text)
                self.seconds += item.seconds
                return
        else:
            yield from map(self._timed, self._queue.stop())
        if isinstance(item, Passthrough) and item.cause and item.end is None:
            self.elsewhere += item.seconds
            yield item
        elif isinstance(item, Passthrough):
            self.seconds += item.seconds
            yield item
        elif item is not None:
            self.seconds += ProfileAtRest.from_move(item, self._rules.limits).trapezoid.seconds
            yield item

    def _lift(self, lift: MoveAtRest, before: Moves) -> Moves:
        """Return a lift as a move, with the limits of the moves before it."""
        points, speed = np.array([lift.start, lift.end]), np.array([lift.speed])
        line, last = np.array([lift.line]), (before.acceleration[-1:], before.corner[-1:])
        return Moves(line, points, speed, *last, before.limits)

    def _timed(self, plan: Plan) -> Plan:
        """Add the time of a plan; return it with the speeds that it reaches."""
        ratio, n, cruise = _joined(self._ratio), len(plan.line), plan.cruise
        self._ratio = [ratio[n:]]
        speed, top, seconds = smoothed_runs(
            plan.s, plan.ends, plan.speed, cruise, plan.acceleration, ratio[plan.ends[:-1]]
        )
        if self._bands is not None:
            self._add_in_bands(replace(plan, speed=speed), top, self._bands)
        if (durations := self._rules.durations) is not None:
            way = np.abs(np.diff(plan.points[:, :E], axis=0) @ self._rules.motors.T).max(axis=1)
            lead = np.add.reduceat(way, plan.ends[:-1])
            d = np.diff(plan.s[plan.ends])
            seconds = durations(lead, d, speed[:-1], speed[1:], cruise, plan.acceleration)
        self.seconds += float(seconds.sum())
        return replace(plan, cruise=top, speed=speed)

    def _add_in_bands(self, plan: Plan, top: Array, bands: MotorBands) -> None:
        """Add a plan's outer walls to the time in bands. top: greatest speed of each run."""
        outer = _joined(self._outer)
        self._outer = [outer[len(plan.line) :]]
        if not outer[: len(plan.line)].any():
            return
        begun, ended = plan.s[plan.ends[:-1]], plan.s[plan.ends[1:]]
        v_s, v_e, a = plan.speed[:-1], plan.speed[1:], plan.acceleration
        ramps = begun + (top**2 - v_s**2) / (2.0 * a), ended - (top**2 - v_e**2) / (2.0 * a)
        # between these ways the acceleration is constant and the direction is that of one move
        ways = np.clip(np.sort(np.concatenate([plan.s, *ramps])), 0.0, plan.s[-1])
        middle = 0.5 * (ways[1:] + ways[:-1])
        move = np.clip(np.searchsorted(plan.s, middle, "right") - 1, 0, len(plan.line) - 1)
        chosen = np.flatnonzero(outer[move] & (np.diff(ways) > 1e-9))
        move, middle = move[chosen], middle[chosen]
        run = np.clip(np.searchsorted(begun, middle, "right") - 1, 0, len(begun) - 1)
        v = np.sqrt([
            np.clip(np.minimum(
                v_s[run] ** 2 + 2.0 * a[run] * (way - begun[run]),
                v_e[run] ** 2 + 2.0 * a[run] * (ended[run] - way),
            ), 1e-6, top[run] ** 2)
            for way in (ways[chosen], ways[chosen + 1])
        ])  # fmt: skip
        way = np.diff(plan.points[:, :E], axis=0)[move]
        seconds = np.diff(ways)[chosen] / v.mean(axis=0)
        shares = bands.share(v.min(axis=0), v.max(axis=0), way[:, :Z] / lengths(way)[:, None])
        self.in_bands.total += float(seconds.sum())
        self.in_bands.inside += float((seconds * shares).sum())


def _joined(parts: list[Any]) -> Any:
    return parts[0] if len(parts) == 1 else np.concatenate(parts)


def _lifts(move: MoveAtRest) -> bool:
    return move.start[Z] != move.end[Z]
