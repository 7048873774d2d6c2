"""Moves in which x and y stand still, as firmware makes them: retractions and lifts."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hframe_post.arrays import TS, Array, E, Integers, Z
from hframe_post.model.constant_acceleration import Trapezoid
from hframe_post.planner.jerk_profile import samples_until
from hframe_post.printer.settings import Limits
from hframe_post.stream.types import Plan, Standing


@dataclass(frozen=True, slots=True)
class StandingProfile:
    """How the firmware, which has no limit on jerk, makes one move while x and y stand still.

    trapezoid: of z, or of the filament if z stands too. seconds: exact duration; samples: until
    the next whole one.
    """

    trapezoid: Trapezoid
    seconds: float
    samples: int

    @classmethod
    def from_move(
        cls, move: Standing, limits: Limits, entry: float = 0.0, leaving: float = 0.0
    ) -> StandingProfile:
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
        if any(ends):  # no standstill next to it can fill up the last sample
            trapezoid = trapezoid.slowed_to(samples * TS)
        return cls(trapezoid, trapezoid.seconds, samples)

    def share(self, samples: Integers) -> Array:
        """Return the share of the move, (n, 1), done after each number of samples (n,)."""
        done = self.trapezoid.distance(samples.astype(float) * TS) / self.trapezoid.length
        return np.where(samples < self.samples, done, 1.0)[:, None]


class TravelRetraction:
    """A retraction made during the travel that follows it."""

    def __init__(self, trapezoid: Trapezoid) -> None:
        self._trapezoid, self._samples = trapezoid, 0
        self.finished = False

    @classmethod
    def if_it_fits(
        cls, move: Standing, travel: Plan, limits: Limits, acceleration: float
    ) -> TravelRetraction | None:
        """Return the retraction, or None if ``move`` is none or the travel is too short for it.

        acceleration: of the filament, mm/s².
        """
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
