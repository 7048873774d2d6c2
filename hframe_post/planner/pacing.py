"""Moves → moves at another pace: acceleration, corners and feed by what is being printed.

    file's moves ──► kind of each (outer wall, infill, travel …) ──► its pace ──► look-ahead

What is kept as the file has it (first layers, bridges, …) keeps its limits, too. A pace never
asks for more than the hot end can melt, nor for more than the extruder can accelerate, nor makes a
layer shorter than it may be: for that each layer has a factor of its own.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import astuple, dataclass, field, replace

import numpy as np

from hframe_post.arrays import Array, E, Flags, Integers, Z, lengths
from hframe_post.stream.features import KINDS, OTHER, TRAVEL, Place, kind
from hframe_post.stream.types import FileLimits, Item, Moves, Passthrough, frozen

NO_LIMITS = FileLimits((math.inf,) * 4, (math.inf,) * 4)
NAMES = (*KINDS, OTHER, TRAVEL)
SAME_HEIGHT = 1e-3  # mm; what the next object's first layer may be off the first one's


@dataclass(frozen=True, slots=True)
class Pace:
    """How hard one kind of feature is driven: mm/s², mm/s at square corners, times the feed."""

    acceleration: float
    corner: float
    feed: float = 1.0


AS_ASKED = Pace(math.inf, math.inf)


@dataclass(frozen=True, slots=True)
class Paces:
    """The pace of each kind of feature; a kind without one keeps what the file has.

    flow: mm of filament a second, at most, where the feed is raised; filament_acceleration: mm/s²
    of it, at most, where the acceleration is. first_layers: how many keep
    what the file has, and with them all that lies as low, where objects are printed one by one.
    layers: factor on the feed of a layer, by its place in the print from 1, where it is not 1.
    """

    kinds: dict[str, Pace]
    flow: float = math.inf
    first_layers: int = 1
    layers: dict[int, float] = field(default_factory=dict)
    filament_acceleration: float = math.inf


@dataclass(frozen=True, slots=True)
class Start:
    """Where a print, or a piece of it, begins. floor: z of what its first layers laid down."""

    place: Place = field(default_factory=Place)
    floor: float = -math.inf


def pace(items: Iterable[Item], paces: Paces, start: Start | None = None) -> Iterator[Item]:
    """The items with the limits and speeds of their moves changed. start: of the first of them."""
    pacer = _Pacer(paces, start or Start())
    for item in items:
        if isinstance(item, Moves):
            yield pacer.moves(item)
        else:
            if isinstance(item, Passthrough):
                pacer.labeller.mark(item.text)
            yield item


class Labeller:
    """Which kind of feature and which layer each move belongs to."""

    def __init__(self, start: Start) -> None:
        self._place, self._floor = replace(start.place), start.floor
        self._kind = NAMES.index(kind(start.place.feature))

    def mark(self, text: bytes) -> None:
        """A line between moves."""
        if self._place.mark(text):
            self._kind = NAMES.index(kind(self._place.feature))

    @property
    def start(self) -> Start:
        """Of what comes next."""
        return Start(replace(self._place), self._floor)

    def of(self, moves: Moves, first_layers: int) -> tuple[Integers, Integers, Flags]:
        """Number in NAMES of each move's kind, its layer, and whether that is a first one, (n,).

        A first layer is one of the first of the print, or lies as low.
        """
        starts, kinds, layers = [0], [self._kind], [self._place.layer]
        for mark in moves.marks:
            self.mark(mark.text)
            starts.append(mark.index)
            kinds.append(self._kind)
            layers.append(self._place.layer)
        times = np.diff([*starts, len(moves.line)])
        number, layer = np.repeat(kinds, times), np.repeat(layers, times)
        laying, z = np.diff(moves.points[:, E]) > 0.0, moves.points[1:, Z]
        number[~laying] = NAMES.index(TRAVEL)
        lowest = laying & (layer > 0) & (layer <= first_layers)
        self._floor = float(z[lowest].max(initial=self._floor))
        first = (layer <= first_layers) | (laying & (z <= self._floor + SAME_HEIGHT))
        return number, layer, first


class _Pacer:
    """How each kind is driven."""

    def __init__(self, paces: Paces, start: Start) -> None:
        self._paces, self.labeller = paces, Labeller(start)
        own = [paces.kinds.get(name) for name in NAMES]
        self._paced = np.array([pace is not None for pace in own])
        self._limits = np.array([astuple(pace or AS_ASKED) for pace in own]).T  # (3, kinds)

    def moves(self, moves: Moves) -> Moves:
        """The moves at their paces. The file's limits by axis become limits of each move."""
        kinds, layer, first = self.labeller.of(moves, self._paces.first_layers)
        delta = np.diff(moves.points, axis=0)
        length = lengths(delta[:, :E])
        chosen = self._paced[kinds] & ~first
        acceleration, corner, feed = self._limits[:, kinds]
        speed, own_acceleration = _by_axis(moves, np.abs(delta) / length[:, None])
        asked = speed * feed * self._factors(layer)
        with np.errstate(divide="ignore"):
            path = 1.0 / np.maximum(delta[:, E] / length, 0.0)  # mm, of a mm of filament
        melts, fed = self._paces.flow * path, self._paces.filament_acceleration * path
        asked = np.minimum(asked, np.maximum(melts, np.minimum(asked, speed)))
        acceleration = np.minimum(acceleration, np.maximum(fed, own_acceleration))
        return replace(
            moves,
            speed=frozen(np.where(chosen, asked, speed)),
            acceleration=frozen(np.where(chosen, acceleration, own_acceleration)),
            corner=frozen(np.where(chosen, corner, moves.corner)),
            limits=NO_LIMITS,
        )

    def _factors(self, layer: Integers) -> Array:
        """Of the feed, (n,)."""
        first, slowed = int(layer[0]), self._paces.layers
        factors = [slowed.get(number, 1.0) for number in range(first, int(layer[-1]) + 1)]
        return np.array(factors)[layer - first]


def _by_axis(moves: Moves, share: Array) -> tuple[Array, Array]:
    """Speed and acceleration (n,) within the file's limits by axis; share (n, 4) of each axis."""
    speed, acceleration = moves.speed.copy(), moves.acceleration.copy()
    with np.errstate(divide="ignore"):
        for axis in range(4):
            if math.isfinite(limit := moves.limits.velocity[axis]):
                np.minimum(speed, limit / share[:, axis], out=speed)
            if math.isfinite(limit := moves.limits.acceleration[axis]):
                np.minimum(acceleration, limit / share[:, axis], out=acceleration)
    return speed, acceleration
