"""Jerk-limited profiles of speed along the runs of a path: the one door to Ruckig."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from ruckig import InputParameter, Ruckig, RuckigError, Trajectory

from hframe_post.arrays import TS, Array, Flags
from hframe_post.errors import HframeError
from hframe_post.native.kernels import kernel
from hframe_post.stream.types import Plan

ALMOST = 0.999  # share of a limit that counts as all of it
DRIFT = 1e-6  # mm by which a profile may miss its run's end through rounding
# Lengths, mm, in which Ruckig is asked, one after the other. It checks in absolute numbers, and at
# great accelerations in mm rounding fails them. Powers of two change no digit.
UNITS = (1.0, 16.0)


@dataclass(frozen=True, slots=True)
class Phases:
    """Constant jerk each.

    table (6, p): start time, duration, and path length, speed, acceleration, jerk at the start.
    """

    table: Array

    def path(self, first: int, n: int, end: float) -> Array:
        """Path length (n,) at samples first, first + 1, …; between phases the last one's end holds.

        Rounding leads neither before 0 nor beyond ``end``.
        """
        if (compiled := kernel("path_lengths")) is None:
            return self._path(TS * np.arange(first, first + n).astype(float), end)
        s = np.empty(n)
        compiled(self.table, self.table.shape[1], first, n, TS, end, s)
        return s

    def _path(self, t: Array, end: float) -> Array:
        time, duration, *_ = self.table
        phase = np.clip(np.searchsorted(time, t, side="right") - 1, 0, None)
        _, _, s, v, a, j = self.table[:, phase]
        dt = np.minimum(t - time[phase], duration[phase])
        length = s + dt * (v + dt * (a / 2.0 + dt * j / 6.0))
        return np.asarray(np.clip(length, 0.0, end))


class Profiler:
    """Profiles of runs: closed form where nothing is to choose, Ruckig elsewhere."""

    def __init__(self) -> None:
        self._ruckig, self._input, self._trajectory = Ruckig(1), InputParameter(1), Trajectory(1)
        self._input.current_position = [0.0]
        self._input.current_acceleration = [0.0]
        self._input.target_acceleration = [0.0]

    def profiles(self, plan: Plan, jerk: float) -> tuple[Array, Array]:
        """Durations and jerks of the seven phases of every run, both (r, 7).

        Runs that leave no choice (one speed, or all of the length needed to change it) are
        written down at once; close to that edge Ruckig's arithmetic fails or overshoots.
        Raises HframeError where no profile fits.
        """
        length = np.diff(plan.s[plan.ends])
        v0, v1 = plan.speed[:-1], plan.speed[1:]
        t, j, acceleration = ramps(v0, v1, length, jerk)
        one_speed = (v0 == v1) & (v0 >= ALMOST * plan.cruise)
        forced = one_speed | (acceleration >= ALMOST * plan.acceleration)
        columns = np.stack([v0, v1, length, plan.cruise, plan.acceleration], axis=1)
        chosen_t, chosen_j = t.copy(), j.copy()
        free = np.flatnonzero(~forced)
        for unit in UNITS:
            self._input.max_jerk = [jerk / unit]
            solved = [self._solve(*row) for row in (columns[free] / unit).tolist()]
            if solved:
                chosen_t[free], chosen_j[free] = (np.array(p) for p in zip(*solved, strict=True))
                chosen_j[free] *= unit
            free = free[_misses(chosen_t[free], chosen_j[free], v0[free], length[free])]
        wrong = _misses(chosen_t, chosen_j, v0, length)
        chosen_t[wrong], chosen_j[wrong] = t[wrong], j[wrong]
        wrong = _misses(chosen_t, chosen_j, v0, length)
        if wrong.any():
            line = plan.line[plan.ends[int(np.argmax(wrong))]]
            raise HframeError(f"line {line}: no jerk-limited profile fits this move's limits")
        return chosen_t, chosen_j

    def _solve(
        self, v0: float, v1: float, length: float, cruise: float, acceleration: float
    ) -> tuple[list[float], list[float]]:
        given = self._input
        given.current_velocity, given.target_velocity = [v0], [v1]
        given.target_position = [length]
        given.max_velocity, given.max_acceleration = [cruise], [acceleration]
        try:
            self._ruckig.calculate(given, self._trajectory)
        except RuckigError:
            return [0.0] * 7, [0.0] * 7
        profile = self._trajectory.profiles[0][0]
        return profile.t, profile.j


def ramps(v0: Array, v1: Array, length: Array, jerk: float) -> tuple[Array, Array, Array]:
    """One change of speed along the whole of each length, with the least acceleration.

    All (r,). Returns durations and jerks of the seven phases, (r, 7), and the acceleration
    (r,): the root of a²/j − T·a + |v1 − v0| = 0 with T = 2·length/(v0 + v1).
    """
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


def integrated(t: Array, j: Array, v0: Array) -> tuple[Array, Array, Array]:
    """Acceleration and speed at the start of each phase, and path along it; all (r, 7)."""
    da = j * t
    a = before_each(np.cumsum(da, axis=1))
    v = v0[:, None] + before_each(np.cumsum(t * (a + da / 2.0), axis=1))
    return a, v, t * (v + t * (a / 2.0 + da / 6.0))


def _misses(t: Array, j: Array, v0: Array, length: Array) -> Flags:
    """Runs whose profile goes backwards or does not end at their length, (r,)."""
    _, v, steps = integrated(t, j, v0)
    misses = np.abs(steps.sum(axis=1) - length) > DRIFT
    return np.asarray(misses | (v.min(axis=1) < -DRIFT))


def before_each(cumulative: Array) -> Array:
    """A cumulative sum along the rows as it stands before each term."""
    shifted = np.zeros_like(cumulative)
    shifted[:, 1:] = cumulative[:, :-1]
    return shifted
