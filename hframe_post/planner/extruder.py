"""Accelerations with which the extruder can follow its pressure advance.

The advance K · dE/dt grows by K·r·a, where the path accelerates by a and takes r mm of filament per
mm. Where E must contain it, the firmware's limits of E hold for it, so lines accelerate by no more
than

    a = v / (K·r),   v: see ``model.pressure_advance.steepest``

as Marlin's own linear advance lowers them. Otherwise the advance would come too late.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np

from hframe_post.arrays import Array, E, lengths
from hframe_post.firmware.dialect import Advance, ExtruderLimits
from hframe_post.model.pressure_advance import steepest
from hframe_post.stream.marks import SETS, Mark, Marks
from hframe_post.stream.types import Item, Moves, Passthrough, frozen

LOWEST = 0.25  # of the acceleration: beyond, K is far from usual, and the advance comes late


class FollowedAdvance:
    """Lowers the accelerations of a print's lines.

    limits: of the extruder. advance: before the first item. acceleration: the greatest of the path,
    mm/s². path, slowed: mm of all lines, and of those that are slower for it; least: mm/s², lowest
    acceleration of these.
    """

    def __init__(self, advance: Advance, limits: ExtruderLimits, acceleration: float) -> None:
        self._advance, self._limits, self._acceleration = advance, limits, acceleration
        self.path, self.slowed, self.least = 0.0, 0.0, np.inf

    @property
    def share(self) -> float:
        """Return the share of all lines that are slower."""
        return self.slowed / self.path if self.path else 0.0

    def items(self, items: Iterable[Item]) -> Iterator[Item]:
        """Yield the items with lower accelerations."""
        for item in items:
            if isinstance(item, Moves):
                yield self._followed(item, self._times(item))
            else:
                said = item.of(SETS) if isinstance(item, Marks) else ()
                for mark in said:
                    self._advance = self._advance.after(mark.text)
                if isinstance(item, Passthrough):
                    self._advance = self._advance.after(item.text)
                yield item

    def _times(self, moves: Moves) -> Array:
        """Return K of each move, (n,), s."""
        K = np.full(len(moves.line), self._advance.seconds)
        for mark in moves.marks.of(SETS):
            self._read(mark, K)
        return K

    def _read(self, mark: Mark, K: Array) -> None:
        self._advance = self._advance.after(mark.text)
        K[mark.index :] = self._advance.seconds

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
