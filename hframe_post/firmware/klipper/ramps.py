"""Klipper's limits while the stream runs, and the feed rates that they need."""

from __future__ import annotations

import math
from dataclasses import astuple, dataclass
from functools import cache

import numpy as np

from hframe_post.arrays import Array, E, Flags, Integers, Z, lengths
from hframe_post.firmware import ramps
from hframe_post.firmware.motion import VELOCITY_HEADROOM, whole_feeds
from hframe_post.model.constant_acceleration import junction_deviation, junction_speeds
from hframe_post.model.kinematics import Kinematics
from hframe_post.native import kernel
from hframe_post.printer.settings import Limits, Motors

SQUARE_CORNER_VELOCITY = 20.0  # mm/s; the stream makes its own corners
LATE = 2e-5  # s; a segment that is later than this is made up for by those after it


@dataclass(frozen=True, slots=True)
class StreamLimits:
    """Klipper's limits while the stream runs; mm, s.

    acceleration: what the motors hold in any direction. A pause or a cancelled print brakes with
    no more than that.
    """

    velocity: float
    acceleration: float
    z_velocity: float
    z_acceleration: float
    extruder_velocity: float
    extruder_acceleration: float
    extruder_corner_velocity: float

    @classmethod
    def from_limits(cls, limits: Limits, motors: Motors, kinematics: Kinematics) -> StreamLimits:
        # no higher than the stream needs: an aborted print leaves them in force
        return cls(
            VELOCITY_HEADROOM * kinematics.max_speed_ratio * motors.belt_velocity,
            math.floor(kinematics.min_speed_ratio * motors.belt_acceleration),
            limits.z_velocity,
            limits.z_acceleration,
            limits.extruder_velocity,
            limits.extruder_acceleration,
            limits.extruder_corner_velocity,
        )

    @property
    def deviation(self) -> float:
        """Return Klipper's junction deviation, mm."""
        return float(junction_deviation(SQUARE_CORNER_VELOCITY, self.acceleration))

    @property
    def lift_corner(self) -> float:
        """Return the speed, mm/s, of Klipper in the corner between a lift and motion in x, y."""
        return SQUARE_CORNER_VELOCITY * math.sqrt(self.z_acceleration / self.acceleration)


@cache
def _row(limits: StreamLimits) -> Array:
    """Return the limits and the junction deviation as the compiled loops take them, (8,)."""
    return np.array([*astuple(limits), limits.deviation])


@dataclass(frozen=True, slots=True)
class Ramped:
    """Segments with Klipper's ramps: length, acceleration and greatest speed of each (k,).

    caps (k + 1,): greatest speeds at their ends.
    """

    d: Array
    a: Array
    top: Array
    caps: Array

    @classmethod
    def from_moves(
        cls, delta: Array, rest: Flags, limits: StreamLimits, after: float = math.inf
    ) -> Ramped:
        """Return the segments of moves delta (k, 4) in x, y, z, e.

        z and retraction lower acceleration and speed. rest (k + 1,): whether Klipper stands at
        each end; after: greatest speed at the last.
        """
        d = lengths(delta[:, :E])
        with np.errstate(divide="ignore"):
            per_z = d / np.abs(delta[:, Z])
            per_e = np.where(delta[:, E] < 0.0, d / np.abs(delta[:, E]), math.inf)
        a = np.minimum(per_z * limits.z_acceleration, per_e * limits.extruder_acceleration)
        top = np.minimum(per_z * limits.z_velocity, per_e * limits.extruder_velocity)
        a, top = np.minimum(a, limits.acceleration), np.minimum(top, limits.velocity)
        corner = limits.extruder_corner_velocity
        inner = junction_speeds(delta, d, a, limits.deviation, corner)
        corners = np.concatenate([[math.inf], inner, [after]])
        return cls(d, a, top, np.where(rest, 0.0, corners))

    def speeds(self, T: Array, before: float) -> Array:
        """Return the cruise speeds (k,) for the times T (k,); before: of the segment before."""
        return ramps.speeds(self.d, T, self.a, self.caps, before)

    def durations(self, v: Array, before: float) -> Array:
        return ramps.durations(self.d, np.minimum(v, self.top), self.a, self.caps, before)


def feeds(
    at: Array, T: Array, rest: Flags, before: float, after: float, limits: StreamLimits,
    per_feed: float,
) -> tuple[Integers, Array]:  # fmt: skip
    """Return F and the seconds that segments then take; see ``MotionRules.feeds``."""
    if (compiled := kernel("klipper_feeds")) is None:
        return _feeds(at, T, rest, before, after, limits, per_feed)
    k = len(T)
    F, taken, room = np.empty(k, np.int64), np.empty(k), np.empty(12 * k + 2)
    compiled(at, k, T, rest, before, after, _row(limits), LATE, per_feed, room, F, taken)
    return F, taken


def _feeds(
    at: Array, T: Array, rest: Flags, before: float, after: float, limits: StreamLimits,
    per_feed: float,
) -> tuple[Integers, Array]:  # fmt: skip
    ramped = Ramped.from_moves(np.diff(at, axis=0), rest, limits, after)
    v = ramped.speeds(T, before)
    late = ramped.durations(v, before) - T
    if late.max() > LATE:
        v = ramped.speeds(made_up(T, np.where(late > LATE, late, 0.0)), before)
    F = whole_feeds(v, per_feed)
    return F, ramped.durations(F / per_feed, before)


def durations(
    at: Array, v: Array, rest: Flags, before: float, after: float, limits: StreamLimits
) -> Array:
    """Return the seconds that segments take; see ``MotionRules.durations``."""
    if (compiled := kernel("klipper_durations")) is None:
        ramped = Ramped.from_moves(np.diff(at, axis=0), rest, limits, after)
        return ramped.durations(v, before)
    k, taken = len(v), np.empty(len(v))
    compiled(at, k, v, rest, before, after, _row(limits), np.empty(12 * k + 2), taken)
    return taken


def made_up(T: Array, late: Array) -> Array:
    """Return T (k,), shortened after segments that are late by (k,) s at any feed rate.

    Lateness waits in a queue, from which each segment in time takes 4 % of its T.
    """
    taken = np.where(late > 0.0, 0.0, 0.04 * T)
    total = np.cumsum(late - taken)
    waiting = total - np.minimum(np.minimum.accumulate(total), 0.0)
    return np.asarray(T - (np.append(0.0, waiting[:-1]) + late - waiting))
