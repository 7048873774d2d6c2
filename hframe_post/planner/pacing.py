"""Moves → moves at another pace: acceleration, corners and feed by what is being printed.

    file's moves ──► kind of each (outer wall, infill, travel …) ──► its pace ──► look-ahead

What is kept as the file has it (first layers, bridges, …) keeps its limits, too. A pace never
asks for more than the hot end can melt, nor makes a layer shorter than it may be: for that each
layer has a factor of its own.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from hframe_post.arrays import Array, E, Integers
from hframe_post.stream.features import FEATURE, NEW_LAYER, OTHER, TRAVEL, kind
from hframe_post.stream.types import FileLimits, Item, Moves, Passthrough, frozen

NO_LIMITS = FileLimits((math.inf,) * 4, (math.inf,) * 4)


@dataclass(frozen=True, slots=True)
class Pace:
    """How hard one kind of feature is driven: mm/s², mm/s at square corners, times the feed."""

    acceleration: float
    corner: float
    feed: float = 1.0


@dataclass(frozen=True, slots=True)
class Paces:
    """The pace of each kind of feature; a kind without one keeps what the file has.

    flow: mm of filament a second, at most, where the feed is raised. first_layers: how many keep
    what the file has. layers: factor on the feed of a layer, by its number from 0, where it is
    not 1.
    """

    kinds: dict[str, Pace]
    flow: float = math.inf
    first_layers: int = 1
    layers: dict[int, float] = field(default_factory=dict)


def pace(items: Iterable[Item], paces: Paces) -> Iterator[Item]:
    """The items with the limits and speeds of their moves changed."""
    pacer = _Pacer(paces)
    for item in items:
        if isinstance(item, Moves):
            yield pacer.moves(item)
        else:
            if isinstance(item, Passthrough):
                pacer.mark(item.text)
            yield item


class _Pacer:
    """The feature and the layer in force."""

    def __init__(self, paces: Paces) -> None:
        self._paces = paces
        self._kind, self._layer = OTHER, -1

    def mark(self, text: bytes) -> None:
        """A line between moves."""
        if match := FEATURE.match(text):
            self._kind = kind(match[1].decode("utf-8", "replace"))
        elif NEW_LAYER.match(text):
            self._layer += 1

    def moves(self, moves: Moves) -> Moves:
        """The moves at their paces. The file's limits by axis become limits of each move."""
        n, starts = len(moves.line), [0]
        spans: list[tuple[str, int]] = [(self._kind, self._layer)]
        for mark in moves.marks:
            self.mark(mark.text)
            starts.append(mark.index)
            spans.append((self._kind, self._layer))
        which = np.searchsorted(starts, np.arange(n), side="right") - 1
        delta = np.diff(moves.points, axis=0)
        length = np.sqrt(np.square(delta[:, :E]).sum(axis=1))
        speed, acceleration = _by_axis(moves, np.abs(delta) / length[:, None])
        corner = moves.corner.copy()
        travels = delta[:, E] <= 0.0
        for number, (feature, layer) in enumerate(spans):
            here = np.flatnonzero(which == number)
            if len(here):
                for part, name in ((here[travels[here]], TRAVEL), (here[~travels[here]], feature)):
                    self._set(part, name, layer, speed, acceleration, corner, delta[:, E] / length)
        return replace(
            moves, speed=frozen(speed), acceleration=frozen(acceleration), corner=frozen(corner),
            limits=NO_LIMITS,
        )  # fmt: skip

    def _set(
        self, which: Integers, name: str, layer: int, speed: Array, acceleration: Array,
        corner: Array, per_mm: Array,
    ) -> None:  # fmt: skip
        """Changes the moves ``which`` (k,); per_mm (n,): filament in a mm of path."""
        chosen = self._paces.kinds.get(name)
        if chosen is None or layer < self._paces.first_layers or not len(which):
            return
        acceleration[which], corner[which] = chosen.acceleration, chosen.corner
        asked = speed[which] * chosen.feed * self._paces.layers.get(layer, 1.0)
        with np.errstate(divide="ignore"):
            melts = self._paces.flow / np.maximum(per_mm[which], 0.0)
        speed[which] = np.minimum(asked, np.maximum(melts, np.minimum(asked, speed[which])))


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
