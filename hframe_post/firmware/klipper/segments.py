"""Segments as Klipper plays them: limits of the stream, ramps, and what it would refuse."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hframe_post.arrays import Array, E, Flags, Integers, Z, lengths
from hframe_post.firmware import ramps
from hframe_post.firmware.player import VELOCITY_HEADROOM
from hframe_post.model.constant_acceleration import junction_deviation, junction_speeds
from hframe_post.model.kinematics import Kinematics
from hframe_post.printer.settings import Limits, Motors

SQUARE_CORNER_VELOCITY = 20.0  # mm/s; the stream makes its own corners
LATE = 2e-5  # s; a segment that is later than this is made up for by those after it
FILAMENT = math.pi * 1.75**2 / 4.0  # mm², its cross section


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
    def lift_corner(self) -> float:
        """Return the speed, mm/s, of Klipper in the corner between a lift and motion in x, y."""
        return SQUARE_CORNER_VELOCITY * math.sqrt(self.z_acceleration / self.acceleration)


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
        square = junction_deviation(SQUARE_CORNER_VELOCITY, limits.acceleration)
        inner = junction_speeds(delta, d, a, square, limits.extruder_corner_velocity)
        corners = np.concatenate([[math.inf], inner, [after]])
        return cls(d, a, top, np.where(rest, 0.0, corners))

    def speeds(self, T: Array, before: float) -> Array:
        """Return the cruise speeds (k,) at which Klipper takes the time T (k,) for each segment.

        before: speed of the segment that precedes.
        """
        return ramps.speeds(self.d, T, self.a, self.caps, before)

    def durations(self, v: Array, before: float) -> Array:
        """Return the time (k,) that Klipper takes at cruise speeds v (k,); see ``speeds``."""
        return ramps.durations(self.d, np.minimum(v, self.top), self.a, self.caps, before)


def thinned(points: Array, ends: Integers) -> Integers:
    """Return ends (k,), and more, so that Klipper refuses no segment as too thick an extrusion.

    Next to a stop the command may crawl where the path does not. Klipper allows a cross section
    of 4 nozzle widths squared (``max_extrude_cross_section``), and more than that in pieces with no
    more filament than such a line as long as the nozzle is wide. The nozzle is estimated from
    the other segments, as lines half as high as wide, at no more than 0.4 mm, since the flow
    may be high.
    """
    usual_nozzle = 0.4  # mm
    allowed = 0.95 * 4.0 * usual_nozzle**2 / FILAMENT  # mm of filament per mm, with a margin
    start = np.append(0, ends[:-1])
    delta = points[ends] - points[start]
    d, e = lengths(delta[:, :E]), delta[:, E]
    lays = (e > 0.0) & (d > 0.0)
    if not lays.any():
        return ends
    usual = float(e[lays].sum() / d[lays].sum())
    nozzle = min(math.sqrt(2.0 * FILAMENT * usual), usual_nozzle)
    most = 0.5 * nozzle * 4.0 * nozzle**2 / FILAMENT
    thick = (e > most) & (e > min(3.0 * usual, max(allowed, 1.5 * usual)) * d)
    if not thick.any():
        return ends
    pieces = [ends]
    for first, end in zip(start[thick].tolist(), ends[thick].tolist(), strict=True):  # few
        piece = np.floor((points[first:end, E] - points[first, E]) / most)
        pieces.append(first + 1 + np.flatnonzero(np.diff(piece[1:])))
    return np.unique(np.concatenate(pieces))


def made_up(T: Array, late: Array) -> Array:
    """Return T (k,), shortened after segments that are late by (k,) s at any feed rate.

    Lateness waits in a queue, from which each segment in time takes 4 % of its T.
    """
    taken = np.where(late > 0.0, 0.0, 0.04 * T)
    total = np.cumsum(late - taken)
    waiting = total - np.minimum(np.minimum.accumulate(total), 0.0)
    return np.asarray(T - (np.append(0.0, waiting[:-1]) + late - waiting))
