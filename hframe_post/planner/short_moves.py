"""Moves that a firmware joins because they have too few steps, as Marlin does.

The next move sets out from where the last one ended that was long enough, at its own speed.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np

from hframe_post.arrays import Array, E, Flags
from hframe_post.stream.marks import NO_MARKS
from hframe_post.stream.types import Item, MoveAtRest, Moves, Position, frozen


class ShortMoves:
    """Joins successive moves.

    least: steps of the shortest move; step: mm of x, y, z and e; motors (4, 4): from mm to steps of
    the motors.
    """

    def __init__(self, least: int, step: Position, motors: Array) -> None:
        self._least, self._step, self._motors = least, np.array(step), motors
        self._origin: Array | None = None  # where the last move ended that is long enough, mm

    def forget(self) -> None:
        """Begin again at a place that the file sets."""
        self._origin = None

    def joined(self, item: Moves | MoveAtRest) -> Moves | MoveAtRest | None:
        """Return the moves in whole steps that are long enough, if any are left."""
        points = item.points if isinstance(item, Moves) else np.array([item.start, item.end])
        points = np.rint(points / self._step) * self._step
        if self._origin is not None:
            points[0] = self._origin
        kept = self._kept(points)
        self._origin = points[1:][kept][-1] if kept.any() else points[0]
        if not kept.any():
            return None
        if not isinstance(item, MoveAtRest):
            return _among(item, points, kept)
        start, end = (_position(place) for place in points.tolist())
        return replace(item, start=start, end=end)

    def joined_travel(self, items: Iterable[Item]) -> Iterator[Item]:
        """Yield the items; where travel has a short move, the next move of it begins there."""
        for item in items:
            if isinstance(item, Moves):
                kept = self._kept(item.points)
                travels = item.points[1:, E] == item.points[:-1, E]
                kept[-1], kept[:-1] = True, kept[:-1] | ~(travels[:-1] & travels[1:])
                item = item if kept.all() else _among(item, item.points, kept)
            yield item

    def _kept(self, points: Array) -> Flags:
        """Return which moves between points (n + 1, 4) are long enough, (n,)."""
        places = points @ self._motors.T
        n, least = len(places) - 1, self._least - 0.5
        kept = np.ones(n, dtype=bool)
        done = 0
        for k in np.flatnonzero(np.abs(np.diff(places, axis=0)).max(axis=1) < least).tolist():
            if k < done:
                continue
            done = k
            while done < n and np.abs(places[done + 1] - places[k]).max() < least:
                kept[done] = False
                done += 1
            done += 1
        return kept


def _position(place: list[float]) -> Position:
    x, y, z, e = place
    return x, y, z, e


def _among(moves: Moves, points: Array, kept: Flags) -> Moves:
    """Return the moves that are kept, (n,), of those between points (n + 1, 4)."""
    places = np.concatenate([points[:1], points[1:][kept]])
    before = np.append(0, np.cumsum(kept))
    marks = moves.marks.moved_to(before[moves.marks.at]) if moves.marks else NO_MARKS
    speed, acceleration, corner = (
        frozen(each[kept]) for each in (moves.speed, moves.acceleration, moves.corner)
    )
    line, limits = moves.line[kept], moves.limits
    return Moves(line, frozen(places), speed, acceleration, corner, limits, marks)
