"""Bands of motor speed that outer walls avoid, because motors leave fine artefacts there.

A motor turns at v·|m·u|: v is the speed of the path, u its direction and m the motor's row of the
kinematics. For a move, the bands of both motors are therefore forbidden intervals of v, and the
nearest speed outside them follows in closed form. A curve goes along one edge of a band up to the
middle, and crosses the band there in one change of speed.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from hframe_post.arrays import Array, E, Flags, Z, lengths
from hframe_post.model.kinematics import Kinematics
from hframe_post.planner.pacing import NAMES, Labeller, PieceStart
from hframe_post.printer.settings import Limits
from hframe_post.stream.marks import Marks
from hframe_post.stream.types import Item, Moves, frozen

OUTER_WALL = "outer-wall"
FIRST_LAYERS = 1  # in which no feed rate is raised
MARGIN = 0.01  # share by which planned speeds stay clear: on curves the command leads the path
SLOWEST, FASTEST = 0.6, 1.15  # times the feed rate
MOST_WAITING = 20_000  # moves that wait for the end of a faster stretch
LONG = 1.3  # times the way in which the band is crossed twice: the shortest faster stretch


@dataclass(frozen=True, slots=True)
class MotorBands:
    """Bands (least, greatest) of the motors' speed, mm/s at the belt."""

    bands: tuple[tuple[float, float], ...]
    kinematics: Kinematics

    @classmethod
    def from_profile(
        cls, bands: tuple[tuple[float, float], ...], kinematics: Kinematics
    ) -> MotorBands | None:
        """Return the bands of a profile; None if it has none."""
        return cls(bands, kinematics) if bands else None

    def intervals(self, direction: Array, margin: float = 0.0) -> tuple[Array, Array]:
        """Return the forbidden path speeds (n, k), least and greatest, by falling greatest ones.

        direction (n, 2): x and y per mm of path. margin: share by which the bands are widened.
        """
        # motors' speeds over that of the path
        ratio = np.abs(self.kinematics.belts(*direction.T)).T
        with np.errstate(divide="ignore"):
            low, high = (
                np.concatenate([end * (1.0 + sign * margin) / ratio for end in ends], axis=1)
                for ends, sign in zip(zip(*self.bands, strict=True), (-1.0, 1.0), strict=True)
            )
        order = np.argsort(-high, axis=1, kind="stable")
        return np.take_along_axis(low, order, axis=1), np.take_along_axis(high, order, axis=1)

    def around(self, speed: Array, direction: Array) -> tuple[Array, Array]:
        """Return the next speeds (n,) below and above ``speed`` at which no motor is in a band.

        Both are ``speed`` itself where no motor is in one. direction (n, 2): as in ``intervals``.
        """
        low, high = (ends.T for ends in self.intervals(direction, MARGIN))
        lower, upper = speed.copy(), speed.copy()
        for least, greatest in zip(low, high, strict=True):
            np.copyto(lower, least, where=(least < lower) & (lower < greatest))
        order = np.argsort(low, axis=0, kind="stable")
        rising = (np.take_along_axis(ends, order, axis=0) for ends in (low, high))
        for least, greatest in zip(*rising, strict=True):
            np.copyto(upper, greatest, where=(least < upper) & (upper < greatest))
        return lower, upper

    def share(self, slower: Array, faster: Array, direction: Array) -> Array:
        """Return which share of a steady change between two path speeds (n,) is in a band, (n,)."""
        low, high = self.intervals(direction)
        span = np.maximum(faster - slower, 1e-9)
        low, high = (
            np.clip(ends, slower[:, None], (slower + span)[:, None]) for ends in (low, high)
        )
        # of the intervals so far: each adds what is below
        least = np.minimum.accumulate(low, axis=1)
        reached = np.concatenate([np.full((len(low), 1), np.inf), least[:, :-1]], axis=1)
        return np.asarray(np.maximum(np.minimum(high, reached) - low, 0.0).sum(axis=1) / span)

    def contains(self, belts: Array) -> Flags:
        """Return at which samples either motor's speed (2, n), mm/s, is in a band, (n,)."""
        inside = np.zeros(belts.shape[1], dtype=bool)
        speed = np.abs(belts)
        for low, high in self.bands:
            inside |= ((speed > low) & (speed < high)).any(axis=0)
        return inside


@dataclass(slots=True)
class TimeInBands:
    """Seconds of outer walls, and of these with a motor in a band."""

    total: float = 0.0
    inside: float = 0.0

    @property
    def share(self) -> float:
        return self.inside / self.total if self.total else 0.0


class OuterWalls:
    """Tells which moves of successive items are outer walls. start: place of the first item.

    first (n,): which of the last moves belong to first layers.
    """

    def __init__(self, start: PieceStart | None = None) -> None:
        self._labeller = Labeller(start or PieceStart())
        self.first = np.zeros(0, dtype=bool)

    def pass_by(self, item: Item) -> None:
        """Note the labels of an item without motion in x and y."""
        self._labeller.pass_by(item)

    def among(self, moves: Moves) -> Flags:
        """Return which of the next moves are outer walls, (n,)."""
        kinds, _, self.first = self._labeller.classify(moves, FIRST_LAYERS)
        return np.asarray(kinds == NAMES.index(OUTER_WALL))


def avoid_bands(
    items: Iterable[Item], bands: MotorBands | None, caps: Limits, start: PieceStart | None = None
) -> Iterator[Item]:
    """Yield the items with outer walls at the nearest speeds outside the bands that motors avoid.

    caps: limits that no file may raise. start: place of the first item.
    """
    if bands is None:
        yield from items
        return
    walls = OuterWalls(start)
    waiting, choices, count = list[Item](), list[_Choice](), 0
    for item in items:
        waiting.append(item)
        goes_on = isinstance(item, Marks)
        if isinstance(item, Moves):
            outer = walls.among(item)
            choices.append(_choice(item, outer, bands, caps, walls.first))
            count += len(outer)
            goes_on = bool(choices[-1].raised[-1]) and count < MOST_WAITING
        else:
            walls.pass_by(item)
        if not (goes_on and choices):
            yield from _with_speeds(waiting, choices)
            waiting, choices, count = [], [], 0
    yield from _with_speeds(waiting, choices)


@dataclass(frozen=True, slots=True)
class _Choice:
    """What n moves may do, (n,) each.

    lower, upper: speeds; raised: whether the upper one is nearer and allowed. length: mm; crossing:
    mm in which a motor crosses the band to the upper speed and back.
    """

    lower: Array
    upper: Array
    raised: Flags
    length: Array
    crossing: Array


def _choice(moves: Moves, outer: Flags, bands: MotorBands, limits: Limits, first: Flags) -> _Choice:
    """Return what moves may do. outer, first (n,): which are outer walls, and in first layers.

    Speeds rise neither in first layers, nor above what the file and the profile allow, nor above
    what the hot end melts. Where neither SLOWEST nor FASTEST is enough, the speed stays.
    """
    if not outer.any():
        nothing = np.zeros(len(outer))
        return _Choice(moves.speed, moves.speed, np.zeros(len(outer), bool), nothing, nothing)
    delta = np.diff(moves.points, axis=0)
    length = lengths(delta[:, :E])
    with np.errstate(divide="ignore"):
        melted = limits.filament_velocity * length / np.maximum(delta[:, E], 0.0)
    acceleration = np.minimum(moves.acceleration, limits.acceleration)
    speed = np.minimum(moves.speed, limits.velocity)
    highest = np.minimum(np.minimum(FASTEST * moves.speed, limits.velocity), melted)
    for values in (highest, speed):
        moves.limits.lower(values, acceleration, moves.points)
    lower, upper = bands.around(speed, delta[:, :Z] / length[:, None])
    raised = outer & ~first & (upper <= highest) & (upper - speed < speed - lower)
    crossing = (np.square(upper) - np.square(lower)) / acceleration
    lower = np.where(outer & (lower >= SLOWEST * speed) & (lower < speed), lower, moves.speed)
    return _Choice(lower, upper, raised, length, crossing)


def _with_speeds(items: Iterable[Item], choices: list[_Choice]) -> Iterator[Item]:
    """Yield items with chosen speeds: the upper ones where they last longer than the crossings."""
    if not choices:
        yield from items
        return
    raised, length, crossing = (
        np.concatenate([getattr(choice, name) for choice in choices])
        for name in ("raised", "length", "crossing")
    )
    starts = np.flatnonzero(np.diff(raised, prepend=~raised[:1]))
    lasting = np.add.reduceat(length, starts) > LONG * np.maximum.reduceat(crossing, starts)
    raised &= np.repeat(lasting, np.diff(starts, append=len(raised)))
    ends, of_items = np.cumsum([len(choice.lower) for choice in choices])[:-1], iter(choices)
    parts = iter(np.split(raised, ends))
    for item in items:
        if isinstance(item, Moves):
            choice = next(of_items)
            yield replace(item, speed=frozen(np.where(next(parts), choice.upper, choice.lower)))
        else:
            yield item
