"""Paths that motors can follow whose limits the printer's owner stated.

A move that asks a belt for more gets slower: in its speed, its acceleration, and in the corners at
its ends. Compensation moves harder than the path, so the path gets a share of the acceleration.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np

from hframe_post.arrays import E, lengths
from hframe_post.model.kinematics import Kinematics
from hframe_post.printer.settings import CORNER_S, Limits, Motors
from hframe_post.stream.types import FileLimits, Item, Moves, frozen

SHARE = 0.6  # of the belts' acceleration: with 0.75, slices had to be clamped a fifth of the time
# Slices on measured printers, two CoreXY and an H-bot, ask for 0.60 to 0.70 of the hardest that
# commands become for any path
LIKELY = 0.72

# mm/s in a ramp to all of that. With motors of 6000 mm/s², commands for a measured Voron were cut
# for 2.0 s of 290 at 18 mm/s, for 1.0 s at 26 mm/s, never at this; strong motors need no such limit
RAMP = 36.0


def with_ramps(limits: Limits, motors: Motors) -> Limits:
    """Return the limits with a jerk at which the compensation stays within stated motors."""
    return replace(limits, jerk=min(limits.jerk, motors.belt_acceleration**2 / RAMP))


class WithinMotors:
    """Slows moves down. path, slowed: mm of all moves, and of those that became slower.

    hardest: acceleration of commands for the hardest path, times the path's.
    """

    def __init__(self, motors: Motors, kinematics: Kinematics, hardest: float = 1.0) -> None:
        share = min(SHARE, 1.0 / (LIKELY * hardest))
        v, a = motors.belt_velocity, share * motors.belt_acceleration
        (ax, ay), (bx, by) = kinematics.matrix.tolist()
        none = (math.inf, math.inf)
        self._limits = FileLimits((v, v, *none), (a, a, *none), belts=((ax, ay), (bx, by)))
        # in a right angle the speed changes by √2 times itself
        self._corner = kinematics.min_speed_ratio * CORNER_S * a / math.sqrt(2.0)
        self.path = self.slowed = 0.0

    @property
    def share(self) -> float:
        """Return the share of the path that is slower."""
        return self.slowed / self.path if self.path else 0.0

    def items(self, items: Iterable[Item]) -> Iterator[Item]:
        """Yield the items with moves that the motors can follow."""
        if math.isinf(self._corner) and math.isinf(self._limits.velocity[0]):  # none are stated
            yield from items
            return
        for item in items:
            yield self._slower(item) if isinstance(item, Moves) else item

    def _slower(self, moves: Moves) -> Moves:
        points = moves.points
        speed, acceleration = moves.speed.copy(), moves.acceleration.copy()
        moves.limits.lower(speed, acceleration, points)
        asked = speed.copy(), acceleration.copy()
        lowered = self._limits.lower(speed, acceleration, points)
        corner = np.minimum(moves.corner, self._corner)
        length = lengths(points[1:, :E] - points[:-1, :E])
        self.path += float(length.sum())
        slowed = corner < moves.corner
        if not lowered and not slowed.any():
            return moves
        slowed |= (speed < asked[0]) | (acceleration < asked[1])
        self.slowed += float(length[slowed].sum())
        return replace(
            moves, speed=frozen(speed), acceleration=frozen(acceleration), corner=frozen(corner)
        )
