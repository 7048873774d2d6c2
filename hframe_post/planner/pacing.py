"""Speeds and accelerations of moves, changed before they are planned: of travel, and by a factor.

file's moves ──► accelerations at the pace asked for ──► travel ──► look-ahead
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from hframe_post.arrays import Array, E, Z
from hframe_post.printer.settings import Limits
from hframe_post.stream.features import Place, kind
from hframe_post.stream.marks import Marks
from hframe_post.stream.types import Item, Moves, Passthrough, frozen

NOT_RAISED = ("bridge", "ironing", "interface", "skirt")  # features
FIRST_LAYERS = 1  # must stick to the bed, so they are not printed harder than in the file


def with_travel_limits(items: Iterable[Item], limits: Limits) -> Iterator[Item]:
    """Yield the items with the profile's speed and acceleration of travel, if it has any.

    Travel extrudes nothing, so it need not be traced exactly. Its acceleration becomes
    ``limits.travel_acceleration``, or what the file asks for in travel alone. Its speed becomes
    ``limits.travel_velocity`` where it is level and, in the file, no slower than the last
    extrusion: slower travel is meant to be slow, for instance to wipe the nozzle.
    """
    if not (limits.travel_velocity or limits.travel_acceleration):
        yield from items
        return
    printed = np.inf  # mm/s of the last extrusion; none yet
    for item in items:
        if not isinstance(item, Moves):
            yield item
            continue
        delta = np.diff(item.points, axis=0)
        travels = delta[:, E] == 0.0
        acceleration, speed = item.acceleration.copy(), item.speed.copy()
        if limits.travel_acceleration:
            acceleration[travels] = min(limits.travel_acceleration, item.limits.travel)
        printing = np.where(delta[:, E] > 0.0, np.arange(len(speed)), -1)
        last = np.maximum.accumulate(printing)
        before = np.where(last < 0, printed, item.speed[last])
        printed = float(item.speed[last[-1]]) if last[-1] >= 0 else printed
        if limits.travel_velocity:
            speed[travels & (delta[:, Z] == 0.0) & (item.speed >= before)] = limits.travel_velocity
        yield replace(item, speed=frozen(speed), acceleration=frozen(acceleration))


@dataclass(frozen=True, slots=True)
class Pace:
    """A factor on what a print asks of acceleration, jerk and corners; its feed rates stay.

    acceleration (mm/s²), corner (mm/s through a right angle): above which no move is raised.
    """

    factor: float = 1.0
    acceleration: float = math.inf
    corner: float = math.inf

    def limits(self, limits: Limits) -> Limits:
        """Return the limits of a profile at this pace."""
        if self.factor == 1.0:
            return limits
        accelerations = {
            name: self._at(getattr(limits, name), self.acceleration)
            for name in ("acceleration", "deceleration", "travel_acceleration")
        }
        return replace(
            limits, jerk=self.factor * limits.jerk,
            square_corner_velocity=self._at(limits.square_corner_velocity, self.corner),
            **accelerations,
        )  # fmt: skip

    def items(self, items: Iterable[Item]) -> Iterator[Item]:
        """Yield the items with their moves at this pace.

        First layers and what must be printed with care (NOT_RAISED) are slowed, but not raised.
        """
        if self.factor == 1.0:
            yield from items
            return
        place = Place()
        for item in items:
            if isinstance(item, Moves):
                yield self._paced(item, place)
            else:
                if isinstance(item, Passthrough):
                    place.mark(item.text)
                elif isinstance(item, Marks):
                    for mark in item.said():
                        place.mark(mark.text)
                yield item

    def _paced(self, moves: Moves, place: Place) -> Moves:
        """Return moves at this pace, with the firmware's limits by axis among their own."""
        speed, acceleration = moves.speed.copy(), moves.acceleration.copy()
        moves.limits.lower(speed, acceleration, moves.points)
        factor = self._factors(moves, place)
        acceleration = self._raised(acceleration, factor, self.acceleration)
        corner = self._raised(moves.corner, factor, self.corner)
        return replace(
            moves, speed=frozen(speed), acceleration=frozen(acceleration), corner=frozen(corner),
            limits=replace(moves.limits, acceleration=(math.inf,) * 4),
        )  # fmt: skip

    def _factors(self, moves: Moves, place: Place) -> Array:
        """Return the factor of each move, (n,); the place passes them."""
        factor, at = np.empty(len(moves.line)), 0
        for mark in (*moves.marks.said(), None):
            end = len(factor) if mark is None else mark.index
            kept = place.layer <= FIRST_LAYERS or kind(place.feature) in NOT_RAISED
            factor[at:end] = min(self.factor, 1.0) if kept else self.factor
            if mark is not None:
                place.mark(mark.text)
            at = end
        return factor

    def _at(self, value: float, most: float) -> float:
        return min(self.factor * value, max(value, most))

    @staticmethod
    def _raised(values: Array, factor: Array, most: float) -> Array:
        return np.minimum(factor * values, np.maximum(values, most))
