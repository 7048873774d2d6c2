"""Profiles of speed: jerk-limited along the runs of a path, and as firmware makes moves at rest.

Only this module uses Ruckig.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from ruckig import InputParameter, Ruckig, RuckigError, Trajectory

from hframe_post.arrays import TS, Array, E, Z
from hframe_post.errors import HframeError
from hframe_post.model.constant_acceleration import Trapezoid
from hframe_post.native.sampling import misses, move_at_rest, ramps, samples_until
from hframe_post.printer.settings import Limits
from hframe_post.stream.types import MoveAtRest, Plan

ALMOST = 0.999  # share of a limit that counts as all of it

Profile = tuple[Array, Array]  # durations and jerks of the seven phases of every run, both (r, 7)


class Profiler:
    """Profiles of runs: in closed form where the limits leave no choice, else from Ruckig."""

    def __init__(self, jerk: float, deceleration: float = math.inf) -> None:
        self._jerk, self._deceleration = jerk, deceleration
        self._ruckig, self._input, self._trajectory = Ruckig(1), InputParameter(1), Trajectory(1)
        self._input.current_position = [0.0]
        self._input.current_acceleration = [0.0]
        self._input.target_acceleration = [0.0]

    def profiles(self, plans: Sequence[Plan]) -> list[Profile]:
        """Return the profile of each plan. Raises HframeError where none fits.

        Runs that leave no choice (one speed, or all of the length needed to change it) have a
        closed form; close to that edge Ruckig's arithmetic fails or overshoots.
        """
        if not plans:
            return []
        length = np.concatenate([s[1:] - s[:-1] for s in (plan.s[plan.ends] for plan in plans)])
        v0, v1 = (
            np.concatenate([plan.speed[part] for plan in plans])
            for part in (slice(None, -1), slice(1, None))
        )
        cruise = np.concatenate([plan.cruise for plan in plans])
        most = np.concatenate([plan.acceleration for plan in plans])
        t, j, acceleration = ramps(v0, v1, length, self._jerk)
        one_speed = (v0 == v1) & (v0 >= ALMOST * cruise)
        braking = np.minimum(most, self._deceleration)
        forced = one_speed | (acceleration >= ALMOST * np.where(v1 < v0, braking, most))
        columns = np.stack([v0, v1, length, cruise, most, -braking], axis=1)
        chosen_t, chosen_j = t.copy(), j.copy()
        free = np.flatnonzero(~forced)
        # Ruckig checks in absolute numbers, which rounding fails at great accelerations in mm: it
        # finds no profile, or one as slow as a ramp. Then it is asked again in a longer unit. A
        # power of two changes no digit.
        ramp = (1.0 - 1e-9) * t.sum(axis=1)
        for unit in (1.0, 16.0):
            if not len(free):
                break
            self._input.max_jerk = [self._jerk / unit]
            solved = [self._solve(*row) for row in (columns[free] / unit).tolist()]
            chosen_t[free], chosen_j[free] = (np.array(p) for p in zip(*solved, strict=True))
            chosen_j[free] *= unit
            slow = (ramp[free] > 0.0) & (chosen_t[free].sum(axis=1) >= ramp[free])
            free = free[slow | misses(chosen_t[free], chosen_j[free], v0[free], length[free])]
        wrong = misses(chosen_t, chosen_j, v0, length)
        if wrong.any():
            chosen_t[wrong], chosen_j[wrong] = t[wrong], j[wrong]
            wrong = misses(chosen_t, chosen_j, v0, length)
        if wrong.any():
            lines = np.concatenate([plan.line[plan.ends[:-1]] for plan in plans])
            line = lines[int(np.argmax(wrong))]
            raise HframeError(f"line {line}: no jerk-limited profile fits this move's limits")
        ends = np.cumsum([len(plan.cruise) for plan in plans]).tolist()
        cuts = [slice(*cut) for cut in pairwise([0, *ends])]
        return [(chosen_t[cut], chosen_j[cut]) for cut in cuts]

    def _solve(
        self, v0: float, v1: float, length: float, cruise: float, most: float, least: float
    ) -> tuple[list[float], list[float]]:
        problem = self._input
        problem.current_velocity, problem.target_velocity = [v0], [v1]
        problem.target_position = [length]
        problem.max_velocity = [cruise]
        problem.max_acceleration, problem.min_acceleration = [most], [least]
        try:
            self._ruckig.calculate(problem, self._trajectory)
        except RuckigError:
            return [0.0] * 7, [0.0] * 7
        profile = self._trajectory.profiles[0][0]
        return profile.t, profile.j


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
