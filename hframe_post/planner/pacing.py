"""Speeds and accelerations of moves, changed before they are planned: of travel, and by feature.

    file's moves ──► feature of each (outer wall, infill, …) ──► its pace ──► travel ──► look-ahead

Features that keep the speeds of the file (first layers, bridges, …) keep its limits, too. A pace
never asks for more than the hot end can melt or the extruder can accelerate. It never makes a layer
shorter than its least time, so each layer has its own factor.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import astuple, dataclass, field, replace

import numpy as np

from hframe_post.arrays import Array, E, Flags, Integers, Z, lengths
from hframe_post.printer.settings import Limits
from hframe_post.stream.features import KINDS, OTHER, TRAVEL, Place, kind
from hframe_post.stream.marks import Marks
from hframe_post.stream.types import Item, Moves, Passthrough, frozen

NAMES = (*KINDS, OTHER, TRAVEL)
UNCHANGED = ("bridge", "ironing", "interface", "skirt")  # features printed as the file says
ADJUSTED = tuple(name for name in (*KINDS, OTHER) if name not in UNCHANGED)
FIRST_LAYERS = 1  # are printed as the file says, too
CORNER = 4e-3  # s: speed at square corners over acceleration; no other gave faster prints
PACED_TOGETHER = 4096  # moves and other items
SAME_HEIGHT = 1e-3  # mm by which first layers of objects printed one by one may differ


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
    """Speeds of one kind of feature: mm/s², mm/s at square corners, and a factor on the feed."""

    acceleration: float
    corner: float
    feed: float


@dataclass(frozen=True, slots=True)
class Paces:
    """The pace of each kind of feature; a kind without one keeps what the file has.

    flow: mm/s of filament, at most, where the feed is raised. filament_acceleration: mm/s² of
    filament, at most, where the acceleration is raised. first_layers: how many layers keep what
    the file has; so does all that lies as low, where objects are printed one by one. layers:
    factor on the feed of a layer, by its place in the print from 1; 1 if missing. min_speed: mm/s,
    below which such a factor slows nothing.
    """

    kinds: dict[str, Pace]
    flow: float = math.inf
    first_layers: int = 1
    layers: dict[int, float] = field(default_factory=dict)
    filament_acceleration: float = math.inf
    min_speed: float = 0.0


@dataclass(frozen=True, slots=True)
class PieceStart:
    """Where a print, or a piece of it, begins. floor: greatest z of its first layers."""

    place: Place = field(default_factory=Place)
    floor: float = -math.inf


def pace(items: Iterable[Item], paces: Paces, start: PieceStart | None = None) -> Iterator[Item]:
    """Yield the items with the speeds and limits of ``paces``. start: place of the first item."""
    pacer, waiting, moves, count = (
        _Pacer(paces, start or PieceStart()),
        list[Item](),
        list[Moves](),
        0,
    )
    for item in items:
        count += 1
        if isinstance(item, Moves):
            if moves and (count >= PACED_TOGETHER or item.limits != moves[0].limits):
                yield from pacer.paced(waiting, moves)
                waiting, moves, count = [], [], 0
            moves.append(item)
            count += len(item.line)
        waiting.append(item)
    yield from pacer.paced(waiting, moves)


class Labeller:
    """Tells which kind of feature and which layer each move belongs to."""

    def __init__(self, start: PieceStart) -> None:
        self._place, self._floor = replace(start.place), start.floor
        self._kind = NAMES.index(kind(start.place.feature))

    def mark(self, text: bytes) -> None:
        if self._place.mark(text):
            self._kind = NAMES.index(kind(self._place.feature))

    def pass_by(self, item: Item) -> None:
        """Read the labels of an item without motion in x and y."""
        if isinstance(item, Passthrough):
            self.mark(item.text)
        elif isinstance(item, Marks):
            for each in item.said():
                self.mark(each.text)

    @property
    def start(self) -> PieceStart:
        return PieceStart(replace(self._place), self._floor)

    def classify(self, moves: Moves, first_layers: int) -> tuple[Integers, Integers, Flags]:
        """Return each move's kind (an index into NAMES), its layer, and whether a first one, (n,).

        What lies as low as the first ``first_layers`` of the print is a first one too.
        """
        extruding = np.diff(moves.points[:, E]) > 0.0
        return self.classify_all([moves], extruding, moves.points[1:, Z], first_layers)

    def classify_all(
        self, items: Iterable[Item], extruding: Flags, z: Array, first_layers: int
    ) -> tuple[Integers, Integers, Flags]:
        """Return the same for the moves of successive items.

        extruding, z (n,): whether each move extrudes, and where it ends.
        """
        times, kinds, layers = list[int](), list[int](), list[int]()
        for item in items:
            if not isinstance(item, Moves):
                self.pass_by(item)
            else:
                at = 0
                for mark in (*item.marks.said(), None):
                    end = len(item.line) if mark is None else mark.index
                    times.append(end - at)
                    kinds.append(self._kind)
                    layers.append(self._place.layer)
                    if mark is not None:
                        self.mark(mark.text)
                    at = end
        number, layer = np.repeat(kinds, times), np.repeat(layers, times)
        number[~extruding] = NAMES.index(TRAVEL)
        lowest = extruding & (layer > 0) & (layer <= first_layers)
        self._floor = float(z[lowest].max(initial=self._floor))
        first = (layer <= first_layers) | (extruding & (z <= self._floor + SAME_HEIGHT))
        return number, layer, first


class _Pacer:
    def __init__(self, paces: Paces, start: PieceStart) -> None:
        self._paces, self._labeller = paces, Labeller(start)
        of_kinds = [paces.kinds.get(name) for name in NAMES]
        unlimited = Pace(math.inf, math.inf, 1.0)
        self._is_paced = np.array([pace is not None for pace in of_kinds])
        self._limits = np.array([astuple(pace or unlimited) for pace in of_kinds]).T  # (3, kinds)

    def paced(self, items: Sequence[Item], moves: Sequence[Moves]) -> Iterator[Item]:
        """Yield the items with the moves among them at their paces.

        The moves have the same limits by axis in the file, which become limits of each move.
        """
        if not moves:
            yield from items
            return
        counts = [len(each.line) for each in moves]
        ends = np.cumsum(counts)
        speed, acceleration, corner = self._limits_of(items, moves, ends)
        cuts = iter(map(slice, (ends - counts).tolist(), ends.tolist()))
        for item in items:
            if isinstance(item, Moves):
                of = next(cuts)
                yield Moves(
                    item.line, item.points, speed[of], acceleration[of], corner[of],
                    replace(item.limits, acceleration=(math.inf,) * 4), item.marks,
                )  # fmt: skip
            else:
                yield item

    def _limits_of(
        self, items: Sequence[Item], moves: Sequence[Moves], ends: Integers
    ) -> tuple[Array, Array, Array]:
        """Return speed, acceleration and corner speed of all moves, (n,)."""
        points = np.concatenate([each.points for each in moves])
        joints = ends[:-1] + np.arange(len(moves) - 1)  # from one item to the next
        delta, z = (
            np.delete(np.diff(points, axis=0), joints, axis=0),
            np.delete(points[1:, Z], joints),
        )
        first_layers = self._paces.first_layers
        kinds, layer, first = self._labeller.classify_all(items, delta[:, E] > 0.0, z, first_layers)
        length = lengths(delta[:, :E])
        chosen = self._is_paced[kinds] & ~first
        acceleration, corner, feed = self._limits[:, kinds]
        file_speed, file_acceleration, file_corner = (
            np.concatenate([getattr(each, name) for each in moves])
            for name in ("speed", "acceleration", "corner")
        )
        starts = [0, *ends[:-1].tolist()]
        for each, first_move in zip(moves, starts, strict=True):
            of = slice(first_move, first_move + len(each.line))
            moves[0].limits.lower(file_speed[of], file_acceleration[of], each.points)
        speed = file_speed * feed
        slowed = speed * self._layer_factors(layer)
        speed = np.maximum(slowed, np.minimum(speed, self._paces.min_speed))
        with np.errstate(divide="ignore"):
            path = 1.0 / np.maximum(delta[:, E] / length, 0.0)  # mm of path per mm of filament
        melted, fed = self._paces.flow * path, self._paces.filament_acceleration * path
        speed = np.minimum(speed, np.maximum(melted, np.minimum(speed, file_speed)))
        acceleration = np.minimum(acceleration, np.maximum(fed, file_acceleration))
        return (
            frozen(np.where(chosen, speed, file_speed)),
            frozen(np.where(chosen, acceleration, file_acceleration)),
            frozen(np.where(chosen, corner, file_corner)),
        )

    def _layer_factors(self, layer: Integers) -> Array:
        first, by_layer = int(layer[0]), self._paces.layers
        factors = [by_layer.get(number, 1.0) for number in range(first, int(layer[-1]) + 1)]
        return np.array(factors)[layer - first]
