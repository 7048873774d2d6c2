"""Profiles of speed: jerk-limited along the runs of a path, and as firmware makes moves at rest.

Only this module uses Ruckig.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from ruckig import InputParameter, Ruckig, RuckigError, Trajectory

from hframe_post.arrays import TS, Array, E, Flags, Integers, Z
from hframe_post.errors import HframeError
from hframe_post.model.kinematics import Trapezoid
from hframe_post.native.planning import misses, move_at_rest, profiles, samples_until
from hframe_post.printer.settings import Limits
from hframe_post.stream.types import MoveAtRest, Plan

NO_JERK_LIMIT = 1e12  # mm/s³ from which on profiles are trapezoids, as firmware makes them
# mm in which Ruckig is asked, again where the first fails. It checks in absolute numbers, which
# rounding fails at great accelerations in mm: it finds no profile, or one as slow as a ramp. A
# power of two changes no digit
UNITS = (1.0, 16.0)

Profile = tuple[Array, Array]  # durations and jerks of the seven phases of every run, both (r, 7)


class _Runs(NamedTuple):
    """Runs of several plans, (r,) each: speeds at both ends, and limits."""

    v0: Array
    v1: Array
    length: Array
    cruise: Array
    acceleration: Array

    @classmethod
    def from_plans(cls, plans: Sequence[Plan]) -> _Runs:
        def joined(parts: Iterable[Array]) -> Array:
            return np.concatenate(list(parts))

        return cls(
            joined(plan.speed[:-1] for plan in plans),
            joined(plan.speed[1:] for plan in plans),
            joined(np.diff(plan.s[plan.ends]) for plan in plans),
            joined(plan.cruise for plan in plans),
            joined(plan.acceleration for plan in plans),
        )

    def trapezoids(self) -> Profile:
        """Return profiles without a limit on jerk: full acceleration, cruise, full braking."""
        v0, v1, length, cruise, a = self
        reached = (2.0 * length + v0 * v0 / a + v1 * v1 / a) / (1.0 / a + 1.0 / a)
        top = np.minimum(cruise, np.sqrt(reached))
        up, down = np.maximum(top - v0, 0.0) / a, np.maximum(top - v1, 0.0) / a
        ramped = (top + v0) / 2.0 * up + (top + v1) / 2.0 * down
        # s that acceleration takes to change
        step_up, step_down = (np.minimum(1e-9, ramp / 2.0) for ramp in (up, down))
        cruised = np.maximum(length - ramped, 0.0) / np.maximum(top, 1e-12)
        t = np.stack([
            step_up, up - step_up, step_up, cruised, step_down, down - step_down, step_down,
        ], axis=1)  # fmt: skip
        j = np.zeros_like(t)
        for phase, way in ((0, a), (2, -a), (4, -a), (6, a)):
            j[:, phase] = way / np.maximum(t[:, phase], 1e-30)
        return t, j

    def missed_by(self, t: Array, j: Array) -> Flags:
        return misses(t, j, self.v0, self.length)


class Profiler:
    """Profiles of runs: in closed form where there is one, else from Ruckig."""

    def __init__(self, jerk: float) -> None:
        self._jerk = jerk
        self._ruckig, self._input, self._trajectory = Ruckig(1), InputParameter(1), Trajectory(1)
        self._input.current_position = [0.0]
        self._input.current_acceleration = [0.0]
        self._input.target_acceleration = [0.0]

    def profiles(self, plans: Sequence[Plan]) -> list[Profile]:
        """Return the profile of each plan. Raises HframeError where none fits."""
        if not plans:
            return []
        runs = _Runs.from_plans(plans)
        ends = np.cumsum([len(plan.cruise) for plan in plans]).tolist()
        cuts = [slice(*cut) for cut in pairwise([0, *ends])]
        if self._jerk >= NO_JERK_LIMIT:
            t, j = runs.trapezoids()
            return [(t[cut], j[cut]) for cut in cuts]
        t, j, others = profiles(*runs, self._jerk)
        ramp_t, ramp_j = t[others], j[others]
        self._search(runs, others, t, j)
        wrong = runs.missed_by(t, j)
        if wrong.any():
            slow = wrong[others]
            t[others[slow]], j[others[slow]] = ramp_t[slow], ramp_j[slow]
            wrong = runs.missed_by(t, j)
        if wrong.any():
            lines = np.concatenate([plan.line[plan.ends[:-1]] for plan in plans])
            line = lines[int(np.argmax(wrong))]
            raise HframeError(f"line {line}: no jerk-limited profile fits this move's limits")
        return [(t[cut], j[cut]) for cut in cuts]

    def _search(self, runs: _Runs, chosen: Integers, t: Array, j: Array) -> None:
        """Replace the ramps t, j (r, 7) of the chosen runs by Ruckig's profiles."""
        ramp = (1.0 - 1e-9) * t.sum(axis=1)
        problems = np.stack(runs, axis=1)
        for unit in UNITS:
            if not len(chosen):
                break
            self._input.max_jerk = [self._jerk / unit]
            solved = [self._solve(*row) for row in (problems[chosen] / unit).tolist()]
            t[chosen], j[chosen] = (np.array(p) for p in zip(*solved, strict=True))
            j[chosen] *= unit
            slow = (ramp[chosen] > 0.0) & (t[chosen].sum(axis=1) >= ramp[chosen])
            chosen = chosen[slow | runs.missed_by(t, j)[chosen]]

    def _solve(
        self, v0: float, v1: float, length: float, cruise: float, most: float
    ) -> tuple[list[float], list[float]]:
        problem = self._input
        problem.current_velocity, problem.target_velocity = [v0], [v1]
        problem.target_position = [length]
        problem.max_velocity = [cruise]
        problem.max_acceleration, problem.min_acceleration = [most], [-most]
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

        entry, leaving: speeds of z at its ends, mm/s, lowered to what a move so short can have, or
        those that are planned.
        """
        dz, de = abs(move.end[Z] - move.start[Z]), abs(move.end[E] - move.start[E])
        length = dz or de
        cruise = min(move.speed, limits.z_velocity) if dz else move.speed
        acceleration = min(move.acceleration, limits.z_acceleration if dz else math.inf)
        if de:  # without x and y any extrusion has the limits of a retraction
            cruise = min(cruise, limits.extruder_velocity * length / de)
            acceleration = min(acceleration, limits.extruder_acceleration * length / de)
        most = min(cruise, math.sqrt(length * acceleration / 2.0)) if dz and not de else 0.0
        planned = move.entry or move.leaving
        ends = (entry, leaving) if planned else (min(entry, most), min(leaving, most))
        trapezoid = Trapezoid(length, cruise, acceleration, *ends)
        samples = samples_until(trapezoid.seconds)
        if planned:  # half a millisecond less is made up for as often as one more
            samples = max(round(trapezoid.seconds / TS), 1)
        if any(ends):  # no rest next to it can fill up the last sample
            trapezoid = trapezoid.slowed_to(samples * TS)
        return cls(trapezoid, samples)

    def fill(self, move: MoveAtRest, first: int, xyze: Array) -> None:
        """Fill in x, y, z, e (n, 4) after ``first``, first + 1, … samples of the move."""
        ends = np.array([move.start, move.end])
        move_at_rest(self.trapezoid.row, ends, first, self.samples, xyze)
