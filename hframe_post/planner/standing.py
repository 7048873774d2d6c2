"""Moves in which x and y stand, as firmware makes them: retractions and lifts."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hframe_post.arrays import TS, Array, E, Integers, Z
from hframe_post.model.trapezoid import Trapezoid
from hframe_post.printer.settings import Limits
from hframe_post.stream.types import Standing

ON_TIME = 1e-9  # samples; a rest this close after a sample falls on it


@dataclass(frozen=True, slots=True)
class StandingProfile:
    """How the firmware makes one move in which x and y stand: it knows no jerk, so a trapezoid.

    trapezoid: of z, or of the filament where z stands too. seconds: exact; samples: until the
    next whole one.
    """

    trapezoid: Trapezoid
    seconds: float
    samples: int

    @classmethod
    def from_move(
        cls, move: Standing, limits: Limits, entry: float = 0.0, leaving: float = 0.0
    ) -> StandingProfile:
        """The fastest that the limits allow, between those speeds of z, or what z can have."""
        dz, de = abs(move.end[Z] - move.start[Z]), abs(move.end[E] - move.start[E])
        length = dz or de
        cruise = min(move.speed, limits.z_velocity) if dz else move.speed
        acceleration = limits.z_acceleration if dz else math.inf
        if de:  # without x and y any extrusion counts as retraction
            cruise = min(cruise, limits.extruder_velocity * length / de)
            acceleration = min(acceleration, limits.extruder_acceleration * length / de)
        most = min(cruise, math.sqrt(length * acceleration / 2.0)) if dz and not de else 0.0
        ends = min(entry, most), min(leaving, most)
        trapezoid = Trapezoid(length, cruise, acceleration, *ends)
        samples = math.ceil(trapezoid.seconds / TS - ON_TIME)
        if any(ends):  # there is no standstill beside it to wait for the sample
            trapezoid = trapezoid.slowed_to(samples * TS)
        return cls(trapezoid, trapezoid.seconds, samples)

    def share(self, samples: Integers) -> Array:
        """Share of the way, (n, 1), done after so many samples (n,)."""
        done = self.trapezoid.distance(samples.astype(float) * TS) / self.trapezoid.length
        return np.where(samples < self.samples, done, 1.0)[:, None]
