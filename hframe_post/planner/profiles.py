"""Profiles of speed: jerk-limited along the runs of a path, and as firmware makes moves at rest."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from hframe_post.arrays import TS, Array, E, Z
from hframe_post.errors import HframeError
from hframe_post.model.constant_acceleration import Trapezoid
from hframe_post.native.planning import move_at_rest, profiles, samples_until
from hframe_post.printer.settings import Limits
from hframe_post.stream.types import MoveAtRest, Plan

Profile = tuple[Array, Array]  # durations and jerks of the seven phases of every run, both (r, 7)


def profiled(plans: Sequence[Plan], jerk: float, deceleration: float = math.inf) -> list[Profile]:
    """Return the profile of each plan. Raises HframeError where none fits."""
    if not plans:
        return []

    def joined(parts: Iterable[Array]) -> Array:
        return np.concatenate(list(parts))

    t, j, found = profiles(
        joined(plan.speed[:-1] for plan in plans), joined(plan.speed[1:] for plan in plans),
        joined(np.diff(plan.s[plan.ends]) for plan in plans),
        joined(plan.cruise for plan in plans), joined(plan.acceleration for plan in plans),
        deceleration, jerk,
    )  # fmt: skip
    if found < len(t):
        line = np.concatenate([plan.line[plan.ends[:-1]] for plan in plans])[found]
        raise HframeError(f"line {line}: no jerk-limited profile fits this move's limits")
    ends = np.cumsum([len(plan.cruise) for plan in plans]).tolist()
    cuts = [slice(*cut) for cut in pairwise([0, *ends])]
    return [(t[cut], j[cut]) for cut in cuts]


@dataclass(frozen=True, slots=True)
class ProfileAtRest:
    """How the firmware, which has no limit on jerk, makes one move while x and y are at rest.

    trapezoid: of z, or of the filament if z rests too; samples: until the next whole one.
    """

    trapezoid: Trapezoid
    samples: int

    @classmethod
    def from_move(
        cls, move: MoveAtRest, limits: Limits, entry: float = 0.0, leaving: float = 0.0
    ) -> ProfileAtRest:
        """Return the fastest profile that the limits allow.

        entry, leaving: speeds of z at its ends, mm/s, lowered to what a move so short can have.
        """
        dz, de = abs(move.end[Z] - move.start[Z]), abs(move.end[E] - move.start[E])
        length = dz or de
        cruise = min(move.speed, limits.z_velocity) if dz else move.speed
        acceleration = limits.z_acceleration if dz else math.inf
        if de:  # without x and y any extrusion has the limits of a retraction
            cruise = min(cruise, limits.extruder_velocity * length / de)
            acceleration = min(acceleration, limits.extruder_acceleration * length / de)
        most = min(cruise, math.sqrt(length * acceleration / 2.0)) if dz and not de else 0.0
        ends = min(entry, most), min(leaving, most)
        trapezoid = Trapezoid(length, cruise, acceleration, *ends)
        samples = samples_until(trapezoid.seconds)
        if any(ends):  # no rest next to it can fill up the last sample
            trapezoid = trapezoid.slowed_to(samples * TS)
        return cls(trapezoid, samples)

    def places(self, move: MoveAtRest, first: int, n: int) -> Array:
        """Return x, y, z, e after ``first``, first + 1, … samples of the move, (n, 4)."""
        ends = np.array([move.start, move.end])
        return move_at_rest(self.trapezoid.row, ends, first, n, self.samples)


class TravelRetraction:
    """A retraction made during the travel that follows it."""

    def __init__(self, trapezoid: Trapezoid) -> None:
        self._trapezoid, self._samples = trapezoid, 0
        self.finished = False

    @classmethod
    def if_it_fits(
        cls, move: MoveAtRest, travel: Plan, limits: Limits, acceleration: float
    ) -> TravelRetraction | None:
        """Return the retraction, or None if ``move`` is none or the travel is too short for it."""
        length = move.start[E] - move.end[E]
        if length <= 0.0 or move.end[Z] != move.start[Z]:
            return None
        trapezoid = Trapezoid(length, min(move.speed, limits.extruder_velocity), acceleration)
        extruding = np.flatnonzero(np.diff(travel.points[:, E]) != 0.0)
        way = float(travel.s[extruding[0]] if len(extruding) else travel.s[-1])
        fits = way >= trapezoid.seconds * float(travel.cruise.max())
        return cls(trapezoid) if fits else None

    def remaining(self, n: int) -> Array:
        """Return the filament (n,), mm, that is not retracted yet at each of the next samples."""
        way = self._trapezoid
        t = TS * np.arange(self._samples + 1.0, self._samples + n + 1.0)
        self._samples += n
        self.finished = bool(t[-1] >= way.seconds)
        return np.where(t < way.seconds, way.length - way.distance(t), 0.0)
