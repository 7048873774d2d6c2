"""Profiles of speed: jerk-limited along the runs of a path, and as firmware makes standing moves.

Only this module uses Ruckig.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from ruckig import InputParameter, Ruckig, RuckigError, Trajectory

from hframe_post.arrays import TS, Array, E, Flags, Z
from hframe_post.errors import HframeError
from hframe_post.model.constant_acceleration import Trapezoid
from hframe_post.native import kernel
from hframe_post.printer.settings import Limits
from hframe_post.stream.types import Plan, Standing

ALMOST = 0.999  # share of a limit that counts as all of it
DRIFT = 1e-6  # mm by which a profile may miss its run's end through rounding


def samples_until(seconds: float) -> int:
    """Return the first whole sample at or after a time, forgiving a billionth of a sample."""
    return math.ceil(seconds / TS - 1e-9)


@dataclass(frozen=True, slots=True)
class Phases:
    """Phases of constant jerk.

    table (6, p): start time, duration, and path length, speed, acceleration, jerk at the start.
    """

    table: Array

    def path(self, first: int, n: int, end: float) -> Array:
        """Return the path length (n,) at samples first, first + 1, …, within 0 … ``end``.

        Between two phases the path stands where the earlier one ended.
        """
        if (compiled := kernel("path_lengths")) is not None:
            lengths = np.empty(n)
            compiled(self.table, self.table.shape[1], first, n, TS, end, lengths)
            return lengths
        t = TS * np.arange(first, first + n).astype(float)
        time, duration, *_ = self.table
        phase = np.clip(np.searchsorted(time, t, side="right") - 1, 0, None)
        _, _, s, v, a, j = self.table[:, phase]
        dt = np.minimum(t - time[phase], duration[phase])
        length = s + dt * (v + dt * (a / 2.0 + dt * j / 6.0))
        return np.asarray(np.clip(length, 0.0, end))


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
            free = free[slow | _misses(chosen_t[free], chosen_j[free], v0[free], length[free])]
        wrong = _misses(chosen_t, chosen_j, v0, length)
        if wrong.any():
            chosen_t[wrong], chosen_j[wrong] = t[wrong], j[wrong]
            wrong = _misses(chosen_t, chosen_j, v0, length)
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


def phases(plan: Plan, profile: Profile, clock: float) -> tuple[Phases, float]:
    """Return the phases of a plan that begins at time ``clock``, s, and the time of its end.

    Points of rest are put on whole samples.
    """
    t, j = profile
    at_ends = plan.s[plan.ends]
    if (compiled := kernel("phases")) is not None:
        room, last = np.empty(6 * t.size), np.empty(1)
        p = compiled(t, j, plan.speed, at_ends, len(t), clock, TS, room, last)
        return Phases(room[: 6 * p].reshape(6, p)), float(last[0])
    a, v, steps = integrate(t, j, plan.speed[:-1])
    end = clock + np.cumsum(np.cumsum(t, axis=1)[:, -1])
    wait = np.zeros(len(end))  # standstill after runs so far, to whole samples
    for run in np.flatnonzero(plan.speed[1:] == 0.0):  # few: corners without speed
        arrival = end[run] + wait[run]
        wait[run:] += max(samples_until(arrival) - arrival / TS, 0.0) * TS
    start = np.concatenate([[clock], end + wait])
    s = at_ends[:-1, None] + _exclusive(np.cumsum(steps, axis=1))
    time = start[:-1, None] + _exclusive(np.cumsum(t, axis=1))
    keep = t.ravel() > 0.0
    table = np.stack([column.ravel()[keep] for column in (time, t, s, v, a, j)])
    return Phases(table), float(start[-1])


def ramps(v0: Array, v1: Array, length: Array, jerk: float) -> tuple[Array, Array, Array]:
    """Return one change of speed along the whole of each length, with the least acceleration.

    All (r,). Returns durations and jerks of the seven phases, (r, 7), and the acceleration
    (r,): the root of a²/j − T·a + |v1 − v0| = 0 with T = 2·length/(v0 + v1).
    """
    if (compiled := kernel("ramps")) is not None:
        (t, j), a = np.empty((2, len(v0), 7)), np.empty(len(v0))
        compiled(v0, v1, length, len(v0), jerk, t, j, a)
        return t, j, a
    change = v1 - v0
    with np.errstate(divide="ignore", invalid="ignore"):
        T = 2.0 * length / (v0 + v1)
        root = np.sqrt(np.maximum(T * T - 4.0 * np.abs(change) / jerk, 0.0))
        a = 2.0 * np.abs(change) / (T + root)
        ramp = a / jerk
        t = np.zeros((len(v0), 7))
        t[:, 0] = t[:, 2] = ramp
        t[:, 1] = np.where(np.isfinite(T), T - 2.0 * ramp, 0.0)
    j = np.zeros((len(v0), 7))
    j[:, 0] = np.copysign(jerk, change)
    j[:, 2] = -j[:, 0]
    return t, j, a


def integrate(t: Array, j: Array, v0: Array) -> tuple[Array, Array, Array]:
    """Return acceleration and speed at the start of each phase, and its path length; all (r, 7)."""
    da = j * t
    a = _exclusive(np.cumsum(da, axis=1))
    v = v0[:, None] + _exclusive(np.cumsum(t * (a + da / 2.0), axis=1))
    return a, v, t * (v + t * (a / 2.0 + da / 6.0))


def _misses(t: Array, j: Array, v0: Array, length: Array) -> Flags:
    """Return which runs have a profile that goes backwards or misses their length, (r,)."""
    if (compiled := kernel("misses")) is not None:
        missed = np.empty(len(t), bool)
        compiled(t, j, v0, length, len(t), DRIFT, missed)
        return missed
    _, v, steps = integrate(t, j, v0)
    misses = np.abs(np.cumsum(steps, axis=1)[:, -1] - length) > DRIFT
    return np.asarray(misses | (v.min(axis=1) < -DRIFT))


def _exclusive(cumulative: Array) -> Array:
    """Return cumulative sums along the rows as they are before each term."""
    shifted = np.zeros_like(cumulative)
    shifted[:, 1:] = cumulative[:, :-1]
    return shifted


@dataclass(frozen=True, slots=True)
class StandingProfile:
    """How the firmware, which has no limit on jerk, makes one move while x and y stand still.

    trapezoid: of z, or of the filament if z stands too; samples: until the next whole one.
    """

    trapezoid: Trapezoid
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
        return cls(trapezoid, samples)

    def places(self, move: Standing, first: int, n: int) -> Array:
        """Return x, y, z, e after ``first``, first + 1, … samples of the move, (n, 4)."""
        way, ends = self.trapezoid, np.array([move.start, move.end])
        if (compiled := kernel("stand")) is not None:
            xyze, speeds = np.empty((n, 4)), (way.v_s, way.acceleration, way.peak)
            trapezoid = np.array([way.length, *speeds, *way.ramps, way.seconds])
            compiled(trapezoid, ends, first, n, self.samples, TS, xyze)
            return xyze
        samples = np.arange(first, first + n)
        done = way.distance(samples.astype(float) * TS) / way.length
        share = np.where(samples < self.samples, done, 1.0)[:, None]
        start, end = ends[:, Z:]
        return np.hstack([np.tile(ends[1, :Z], (n, 1)), start + share * (end - start)])


class TravelRetraction:
    """A retraction made during the travel that follows it."""

    def __init__(self, trapezoid: Trapezoid) -> None:
        self._trapezoid, self._samples = trapezoid, 0
        self.finished = False

    @classmethod
    def if_it_fits(
        cls, move: Standing, travel: Plan, limits: Limits, acceleration: float
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
