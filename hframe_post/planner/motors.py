"""Moves that motors can follow: those of x and y whose limits the owner stated, and the extruder's.

A move that asks a belt for more gets slower: in its speed, its acceleration, and in the corners at
its ends. Compensation moves harder than the path, so the path gets a share of the acceleration.

The advance K · dE/dt of an extruder grows by K·r·a, where the path accelerates by a and takes r mm
of filament per mm. Where E must contain it, the firmware's limits of E hold for it, so lines
accelerate by no more than

    a = v / (K·r),   v: see ``model.pressure_advance.steepest``

as Marlin's own linear advance lowers them. Otherwise the advance would come too late.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np

from hframe_post.arrays import Array, E, lengths
from hframe_post.firmware.dialect import Advance, ExtruderLimits
from hframe_post.model.kinematics import Kinematics
from hframe_post.model.pressure_advance import steepest
from hframe_post.printer.settings import CORNER_S, Limits, Motors
from hframe_post.stream.marks import SETS
from hframe_post.stream.types import FileLimits, Item, Moves, frozen, said

SHARE = 0.6  # of the belts' acceleration: with 0.75, slices had to be clamped a fifth of the time
# Slices on measured printers, two CoreXY and an H-bot, ask for 0.60 to 0.70 of the hardest that
# commands become for any path
LIKELY = 0.72

# mm/s in a ramp to all of that. With motors of 6000 mm/s², commands for a measured Voron were cut
# for 2.0 s of 290 at 18 mm/s, for 1.0 s at 26 mm/s, never at this; strong motors need no such limit
RAMP = 36.0
LOWEST = 0.25  # of a line's acceleration: beyond, K is far from usual, and the advance comes late


def with_ramps(limits: Limits, motors: Motors) -> Limits:
    """Return the limits with a jerk at which the compensation stays within stated motors."""
    return replace(limits, jerk=min(limits.jerk, motors.belt_acceleration**2 / RAMP))


class _Slowed:
    """Path that was looked at, and path that is slower for it, mm."""

    path = slowed = 0.0

    @property
    def share(self) -> float:
        """Return the share of the path that is slower."""
        return self.slowed / self.path if self.path else 0.0


class WithinMotors(_Slowed):
    """Slows moves down for x and y.

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


class FollowedAdvance(_Slowed):
    """Lowers the accelerations of a print's lines.

    limits: of the extruder. advance: before the first item. acceleration: the greatest of the path,
    mm/s². path is that of all lines; least: mm/s², lowest acceleration of those that are slower.
    """

    def __init__(self, advance: Advance, limits: ExtruderLimits, acceleration: float) -> None:
        self._advance, self._limits, self._acceleration = advance, limits, acceleration
        self.least = math.inf

    def items(self, items: Iterable[Item]) -> Iterator[Item]:
        """Yield the items with lower accelerations."""
        for item in items:
            if isinstance(item, Moves):
                yield self._followed(item, self._times(item))
            else:
                for mark in said(item, SETS):
                    self._advance = self._advance.after(mark.text)
                yield item

    def _times(self, moves: Moves) -> Array:
        """Return K of each move, (n,), s."""
        K = np.full(len(moves.line), self._advance.seconds)
        for mark in moves.marks.of(SETS):
            self._advance = self._advance.after(mark.text)
            K[mark.index :] = self._advance.seconds
        return K

    def _followed(self, moves: Moves, K: Array) -> Moves:
        if not K.any():
            return moves
        delta = np.diff(moves.points, axis=0)
        length = lengths(delta[:, :E])
        per_mm = np.maximum(delta[:, E], 0.0) / length
        speed = per_mm * moves.speed
        half = self._advance.half(computed=True)
        room = np.maximum(self._limits.velocity - speed, LOWEST * self._limits.velocity)
        most = np.minimum(steepest(*self._limits, half), room)
        with np.errstate(divide="ignore"):
            highest = most / (K * per_mm)
        asked = np.minimum(moves.acceleration, self._acceleration)
        lowered = highest < asked
        self.path += float(length[per_mm > 0.0].sum())
        if not lowered.any():
            return moves
        acceleration = np.where(lowered, np.maximum(highest, LOWEST * asked), moves.acceleration)
        self.slowed += float(length[lowered].sum())
        self.least = min(self.least, float(acceleration[lowered].min()))
        return replace(moves, acceleration=frozen(acceleration))
