"""Accelerations of moves times factors, before they are planned."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from hframe_post.arrays import Array, E
from hframe_post.printer.settings import Limits
from hframe_post.stream.features import Place, kind
from hframe_post.stream.marks import PLACES
from hframe_post.stream.types import Item, Moves, frozen, said

NOT_RAISED = ("bridge", "ironing", "interface", "skirt")  # features
OUTER_WALL = "outer-wall"


@dataclass(frozen=True, slots=True)
class Pace:
    """A factor on what a print asks of acceleration, jerk and corners; its feed rates stay.

    acceleration (mm/s²), corner (mm/s through a right angle): above which no move is raised.
    walls: another factor on the acceleration of outer walls, on which errors show.
    """

    factor: float = 1.0
    acceleration: float = math.inf
    corner: float = math.inf
    walls: float = 1.0

    def limits(self, limits: Limits) -> Limits:
        """Return the limits of a profile at this pace."""
        if self.factor == 1.0:
            return limits
        return replace(
            limits, jerk=self.factor * limits.jerk,
            square_corner_velocity=self._at(limits.square_corner_velocity, self.corner),
            acceleration=self._at(limits.acceleration, self.acceleration),
        )  # fmt: skip

    def items(self, items: Iterable[Item]) -> Iterator[Item]:
        """Yield the items with their moves at this pace.

        First layers and what must be printed with care (NOT_RAISED) are slowed, but not raised.
        """
        if self.factor == self.walls == 1.0:
            yield from items
            return
        place = Place()
        for item in items:
            if isinstance(item, Moves):
                yield self._paced(item, place)
            else:
                for mark in said(item, PLACES):
                    place.mark(mark.text)
                yield item

    def _paced(self, moves: Moves, place: Place) -> Moves:
        """Return moves at this pace, with the firmware's limits by axis among their own."""
        speed, acceleration = moves.speed.copy(), moves.acceleration.copy()
        moves.limits.lower(speed, acceleration, moves.points)
        factor, walls = self._factors(moves, place)
        acceleration = walls * self._raised(acceleration, factor, self.acceleration)
        corner = self._raised(moves.corner, factor, self.corner)
        return replace(
            moves, speed=frozen(speed), acceleration=frozen(acceleration), corner=frozen(corner),
            limits=replace(moves.limits, acceleration=(math.inf,) * 4),
        )  # fmt: skip

    def _factors(self, moves: Moves, place: Place) -> tuple[Array, Array]:
        """Return both factors of each move, (n,); the place passes them."""
        (factor, walls), at = np.ones((2, len(moves.line))), 0
        for mark in (*moves.marks.of(PLACES), None):
            end, feature = len(factor) if mark is None else mark.index, kind(place.feature)
            kept = place.layer <= 1 or feature in NOT_RAISED  # the first must stick to the bed
            factor[at:end] = min(self.factor, 1.0) if kept else self.factor
            walls[at:end] = self.walls if feature == OUTER_WALL else 1.0
            if mark is not None:
                place.mark(mark.text)
            at = end
        walls[np.diff(moves.points[:, E]) <= 0.0] = 1.0  # travel
        return factor, walls

    def _at(self, value: float, most: float) -> float:
        return min(self.factor * value, max(value, most))

    @staticmethod
    def _raised(values: Array, factor: Array, most: float) -> Array:
        return np.minimum(factor * values, np.maximum(values, most))
