"""The motion that the firmware itself makes of a file as it was sliced, and how long it takes.

It accelerates at once (no limit on jerk), and has corners, accelerations and speeds of its own.
What a print has today is judged on this motion, and every print time is compared with it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import chain

import numpy as np

from hframe_post.arrays import Array, E, Flags, Z, lengths
from hframe_post.firmware.base import FirmwareLimits
from hframe_post.planner.bands import MotorBands, OuterWalls, TimeInBands
from hframe_post.planner.lookahead import Lookahead
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

    standing: what of them x and y rest.
    in_bands: the outer walls' time, and what of it a motor spends in these bands.
    """

    def __init__(self, rules: FirmwareLimits, bands: MotorBands | None = None) -> None:
        self._rules, self._queue = rules, Lookahead(rules.limits)
        self.seconds = self.standing = 0.0
        self._bands, self._walls, self.in_bands = bands, OuterWalls(), TimeInBands()
        self._outer = list[Flags]()  # which of the queued moves are outer walls

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
            self._queue.append(self._limited(item))
            while (plan := self._queue.take_final()) is not None:
                yield self._timed(plan)
            return
        if isinstance(item, Passthrough) and item.handling is Handling.CARRY:
            if self._queue.count:
                self._queue.mark(item.text)
                self._stand(item.seconds)
                return
        else:
            yield from map(self._timed, self._queue.stop())
        if item is not None:
            self._stand(item.seconds if isinstance(item, Passthrough) else self._at_rest(item))
            yield item

    def _stand(self, seconds: float) -> None:
        self.seconds += seconds
        self.standing += seconds

    def _limited(self, moves: Moves) -> Moves:
        """Return the moves with the firmware's accelerations where the file sets none."""
        travels = np.diff(moves.points[:, E]) == 0.0
        usual = np.where(travels, self._rules.travel, self._rules.printing)
        own = np.where(np.isfinite(moves.acceleration), moves.acceleration, usual)
        if (belts := self._rules.belts) is not None:
            way = np.diff(moves.points[:, :E], axis=0)
            share = np.abs(way[:, :Z] @ belts.T) / np.linalg.norm(way, axis=1)[:, None]
            asked = np.array(moves.limits.acceleration[:Z])
            most = np.where(np.isfinite(asked), asked, self._rules.motors)
            own = np.minimum(own, (most / np.maximum(share, 1e-9)).min(axis=1))
        # a board with junction deviation knows no other rule, whatever the file says
        knows = math.isinf(self._rules.limits.junction_deviation)
        corner = moves.corner if knows else np.full_like(moves.corner, math.inf)
        return replace(moves, acceleration=own, corner=corner)

    def _timed(self, plan: Plan) -> Plan:
        """Add the time of a plan; return it with the speeds that it reaches."""
        d, v = np.diff(plan.s[plan.ends]), plan.speed
        v_s, v_e, cruise, a = v[:-1], v[1:], plan.cruise, plan.acceleration
        ramped = (1.0 - self._rules.cruise_ratio) * a * d
        reached = np.sqrt(np.maximum(ramped + (v_s**2 + v_e**2) / 2.0, np.maximum(v_s, v_e) ** 2))
        top = np.minimum(cruise, reached)
        if self._bands is not None:
            self._add_in_bands(plan, top, self._bands)
        durations, belts = self._rules.durations, self._rules.belts
        if durations is None or belts is None:
            self.seconds += float(_seconds(d, v_s, v_e, top, a).sum())
        else:
            lead = np.abs(np.diff(plan.points[:, :Z], axis=0) @ belts.T).max(axis=1)
            lead = np.add.reduceat(lead, plan.ends[:-1])
            self.seconds += float(durations(lead, d, v_s, v_e, cruise, a).sum())
        return replace(plan, cruise=top)

    def _add_in_bands(self, plan: Plan, top: Array, bands: MotorBands) -> None:
        """Add a plan's outer walls to the time in bands. top: greatest speed of each run."""
        outer = np.concatenate(self._outer)
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

    def _at_rest(self, move: MoveAtRest) -> float:
        limits, delta = self._rules.limits, np.abs(np.subtract(move.end, move.start))
        z = delta[Z] > 0.0
        d, v, a = (
            (delta[Z], limits.z_velocity, limits.z_acceleration)
            if z
            else (delta[E], limits.extruder_velocity, limits.extruder_acceleration)
        )
        if not d:
            return 0.0
        top = min(move.speed, v, math.sqrt(a * d))
        return float(d / top + top / a)


def seconds_of_ramps(plan: Plan) -> float:
    """Return how long a plan takes if nothing limits its jerk."""
    d, v, a = np.diff(plan.s[plan.ends]), plan.speed, plan.acceleration
    v_s, v_e = v[:-1], v[1:]
    reached = np.sqrt(np.maximum(a * d + (v_s**2 + v_e**2) / 2.0, np.maximum(v_s, v_e) ** 2))
    return float(_seconds(d, v_s, v_e, np.minimum(plan.cruise, reached), a).sum())


def _seconds(d: Array, v_s: Array, v_e: Array, top: Array, a: Array) -> Array:
    """Return the seconds (n,) of ways d (mm) from speed to speed over a speed between."""
    cruised = np.maximum(d - (2.0 * top**2 - v_s**2 - v_e**2) / (2.0 * a), 0.0)
    return np.asarray((2.0 * top - v_s - v_e) / a + cruised / top)
