"""Segments as Klipper plays them: its limits in the stream, its ramps, what it would refuse."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hframe_post.arrays import Array, E, Flags, Integers, Z, lengths
from hframe_post.firmware import ramps
from hframe_post.firmware.player import VELOCITY_HEADROOM
from hframe_post.model import cornering
from hframe_post.model.kinematics import Kinematics
from hframe_post.printer.settings import Limits, Motors

SQUARE_CORNER_VELOCITY = 20.0  # mm/s; corners are the stream's business
LATE = 2e-5  # s; what a segment is late by in spite of its feed rate, if more, is made up for
CATCH_UP = 0.04  # share of its time by which a segment makes up for late ones before it
FILAMENT = math.pi * 1.75**2 / 4.0  # mm², its cross section
USUAL_NOZZLE = 0.4  # mm
ALLOWED = 0.95 * 4.0 * USUAL_NOZZLE**2 / FILAMENT  # mm of filament per mm, nearly all that it may
THICK = 3.0  # times the usual filament for its length: a segment that may have to be cut;
THICKER = 1.5  # the same where that is more than Klipper allows of a usual nozzle
SAFELY = 0.5  # share of the filament that Klipper takes for however short a segment


@dataclass(frozen=True, slots=True)
class StreamLimits:
    """Klipper's limits while the stream runs; mm, s.

    acceleration: what the motors hold in any direction, and so the most with which a pause or a
    cancelled print brakes.
    """

    velocity: float
    acceleration: float
    z_velocity: float
    z_acceleration: float
    extruder_velocity: float
    extruder_acceleration: float
    extruder_corner_velocity: float

    @classmethod
    def of(cls, limits: Limits, motors: Motors, kinematics: Kinematics) -> StreamLimits:
        """High enough never to shape the stream, and no higher: they may be left behind."""
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
        """At which Klipper takes the corner between a lift and motion in x and y, mm/s."""
        return SQUARE_CORNER_VELOCITY * math.sqrt(self.z_acceleration / self.acceleration)


@dataclass(frozen=True, slots=True)
class Ramped:
    """k segments as Klipper ramps in them: length, acceleration and greatest speed of each (k,).

    caps (k + 1,): greatest speeds at their ends.
    """

    d: Array
    a: Array
    top: Array
    caps: Array

    @classmethod
    def of(cls, delta: Array, rest: Flags, limits: StreamLimits, after: float = math.inf) -> Ramped:
        """From x, y, z, e of each, delta (k, 4): z and retraction lower acceleration and speed.

        rest (k + 1,): whether Klipper stands at each end; after: greatest speed at the last.
        """
        d = lengths(delta[:, :E])
        with np.errstate(divide="ignore"):
            per_z = d / np.abs(delta[:, Z])
            per_e = np.where(delta[:, E] < 0.0, d / np.abs(delta[:, E]), math.inf)
        a = np.minimum(per_z * limits.z_acceleration, per_e * limits.extruder_acceleration)
        top = np.minimum(per_z * limits.z_velocity, per_e * limits.extruder_velocity)
        a, top = np.minimum(a, limits.acceleration), np.minimum(top, limits.velocity)
        square = cornering.junction_deviation(SQUARE_CORNER_VELOCITY, limits.acceleration)
        inner = cornering.junction_speeds(delta, d, a, square, limits.extruder_corner_velocity)
        corners = np.concatenate([[math.inf], inner, [after]])
        return cls(d, a, top, np.where(rest, 0.0, corners))

    def speeds(self, T: Array, before: float) -> Array:
        """Cruise speeds (k,) at which Klipper takes the time T (k,) for each segment.

        before: speed of the segment that precedes.
        """
        return ramps.speeds(self.d, T, self.a, self.caps, before)

    def durations(self, v: Array, before: float) -> Array:
        """Time (k,) that Klipper takes at cruise speeds v (k,); see ``speeds``."""
        return ramps.durations(self.d, np.minimum(v, self.top), self.a, self.caps, before)


def thinned(points: Array, ends: Integers) -> Integers:
    """More ends (k,), so that no segment is one that Klipper refuses as too thick an extrusion.

    Beside a stop a command may crawl where the path does not. Klipper allows a width of 4 nozzles
    squared (``max_extrude_cross_section``), and more than that in pieces of no more filament than
    it would take for a line as long as the nozzle is wide. That is told by how thick the
    other segments are, of a line as wide and half as high; but it is taken to be no
    wider than USUAL_NOZZLE, since a flow may be high.
    """
    start = np.append(0, ends[:-1])
    delta = points[ends] - points[start]
    d, e = lengths(delta[:, :E]), delta[:, E]
    lays = (e > 0.0) & (d > 0.0)
    if not lays.any():
        return ends
    usual = float(e[lays].sum() / d[lays].sum())
    nozzle = min(math.sqrt(2.0 * FILAMENT * usual), USUAL_NOZZLE)
    most = SAFELY * nozzle * 4.0 * nozzle**2 / FILAMENT
    thick = (e > most) & (e > min(THICK * usual, max(ALLOWED, THICKER * usual)) * d)
    if not thick.any():
        return ends
    pieces = [ends]
    for first, end in zip(start[thick].tolist(), ends[thick].tolist(), strict=True):  # few
        piece = np.floor((points[first:end, E] - points[first, E]) / most)
        pieces.append(first + 1 + np.flatnonzero(np.diff(piece[1:])))
    return np.unique(np.concatenate(pieces))


def made_up(T: Array, late: Array) -> Array:
    """T (k,), shortened after segments that are late (k,), s, whatever is asked of them.

    A queue: what is late waits, and each segment in time takes CATCH_UP of its T away.
    """
    taken = np.where(late > 0.0, 0.0, CATCH_UP * T)
    total = np.cumsum(late - taken)
    waiting = total - np.minimum(np.minimum.accumulate(total), 0.0)
    return np.asarray(T - (np.append(0.0, waiting[:-1]) + late - waiting))
