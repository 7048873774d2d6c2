"""Klipper's limits while the stream runs."""

from __future__ import annotations

import math
from dataclasses import astuple, dataclass
from functools import cached_property

import numpy as np

from hframe_post.arrays import Array
from hframe_post.firmware.motion import VELOCITY_HEADROOM
from hframe_post.model.kinematics import Kinematics
from hframe_post.native.planning import junction_deviation
from hframe_post.printer.settings import Limits, Motors

SQUARE_CORNER_VELOCITY = 20.0  # mm/s; the stream makes its own corners


@dataclass(frozen=True)
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

    @cached_property
    def row(self) -> Array:
        """Return the limits and Klipper's junction deviation, mm, (8,)."""
        deviation = junction_deviation(SQUARE_CORNER_VELOCITY, self.acceleration)
        return np.array([*astuple(self), float(deviation)])

    @property
    def lift_corner(self) -> float:
        """Return the speed, mm/s, of Klipper in the corner between a lift and motion in x, y."""
        return SQUARE_CORNER_VELOCITY * math.sqrt(self.z_acceleration / self.acceleration)
