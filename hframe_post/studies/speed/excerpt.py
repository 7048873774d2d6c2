"""A minute or two of a print that stand for all of it: pieces from everywhere, of every kind.

    items ──► pieces of some seconds ──► those of kinds of which little has been kept yet

Of each kind of feature an even share is kept, in the order of the print; a larger one of what is
rare, as its root. Once that is too much, every other piece goes and the share is halved: what is
held does not grow with the print.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from hframe_post.arrays import Array, E, Integers
from hframe_post.planner.pacing import NAMES, Labeller, Start
from hframe_post.stream.features import TRAVEL
from hframe_post.stream.types import Handling, Item, Mark, Moves, Passthrough

PIECE = 3.0  # s at the file's feed rates
SHARE = 0.03  # of a print, at least,
LEAST, MOST = 40.0, 100.0  # s, and within these, that are kept; up to twice as much
FEWEST = 0.02  # of a kind's way that is passed over
NOTICED = 0.2  # s of a kind in a piece for whose sake it is kept


@dataclass(frozen=True, slots=True)
class Piece:
    """Items in succession, from rest to rest. seconds: by kind, as the file asks for them."""

    start: Start
    items: tuple[Item, ...]
    seconds: dict[str, float]


@dataclass
class _Kept:
    """The pieces kept so far, the share that they are, and what was seen and kept of each kind."""

    pieces: list[Piece] = field(default_factory=list)
    share: float = 1.0
    seen: dict[str, float] = field(default_factory=dict)
    kept: dict[str, float] = field(default_factory=dict)

    def take(self, piece: Piece) -> None:
        """Keeps the piece if little has been kept of one of its kinds."""
        _add(self.seen, piece)
        so_far = sum(self.seen.values())
        if any(
            seconds > NOTICED
            and self.kept.get(name, 0.0) < self.share * np.sqrt(self.seen[name] * so_far)
            for name, seconds in piece.seconds.items()
        ):
            self.pieces.append(piece)
            _add(self.kept, piece)
        enough = min(max(SHARE * sum(self.seen.values()), LEAST), MOST)
        while sum(self.kept.values()) > 2.0 * enough and len(self.pieces) > 1:
            self.pieces, self.share = self.pieces[::2], self.share / 2.0
            self.kept.clear()
            for left in self.pieces:
                _add(self.kept, left)


def excerpt(items: Iterable[Item], first_layers: int = 1) -> list[Piece]:
    """Pieces of a print, all of it if it is short; nothing of its first layers."""
    kept = _Kept()
    for piece in _pieces(items, first_layers):
        kept.take(piece)
    return kept.pieces


def hurry(pieces: Iterable[Piece], velocity: float, flow: float) -> dict[str, float]:
    """Times its feed, the fastest that each kind can be: all of it but FEWEST of its way.

    velocity: mm/s of the path; flow: mm of filament a second.
    """
    factors: dict[str, list[Array]] = {}
    for piece in pieces:
        labeller = Labeller(piece.start)
        for item in piece.items:
            if isinstance(item, Passthrough):
                labeller.mark(item.text)
            elif isinstance(item, Moves):
                kinds, _, _ = labeller.classify(item, 0)
                delta = np.diff(item.points, axis=0)
                length = np.sqrt(np.square(delta[:, :E]).sum(axis=1))
                with np.errstate(divide="ignore"):
                    melts = flow / np.maximum(delta[:, E] / length, 0.0)
                factor = np.minimum(velocity, melts) / item.speed
                for k in np.unique(kinds).tolist():
                    rows = np.stack([factor, length])[:, kinds == k]
                    factors.setdefault(NAMES[k], []).append(rows)
    return {name: _most(np.concatenate(rows, axis=1)) for name, rows in factors.items()}


def _most(rows: Array) -> float:
    """The greatest factor of rows (2, n), factors and lengths, but for FEWEST of the length."""
    factor, length = rows[:, np.argsort(rows[0])]
    way = np.cumsum(length)
    return float(factor[np.searchsorted(way, (1.0 - FEWEST) * way[-1])])


def _add(total: dict[str, float], piece: Piece) -> None:
    for name, seconds in piece.seconds.items():
        total[name] = total.get(name, 0.0) + seconds


def _pieces(items: Iterable[Item], first_layers: int) -> Iterator[Piece]:
    """The whole print in pieces. What must reach the machine at rest lies between two of them."""
    labeller = Labeller(Start())
    start, held, seconds = labeller.start, list[Item](), dict[str, float]()

    def ended() -> Iterator[Piece]:
        nonlocal start, held, seconds
        if any(name != TRAVEL for name in seconds):
            yield Piece(start, tuple(held), seconds)
        start, held, seconds = labeller.start, [], {}

    for item in items:
        if isinstance(item, Moves):
            for part in _parts(item):
                kinds, _, first = labeller.classify(part, first_layers)
                if first.any():
                    yield from ended()
                    continue
                held.append(part)
                for name, more in _seconds(part, kinds).items():
                    seconds[name] = seconds.get(name, 0.0) + more
                if sum(seconds.values()) >= PIECE:
                    yield from ended()
        elif isinstance(item, Passthrough):
            labeller.mark(item.text)
            if item.handling is Handling.CARRY:
                held.append(item)
            else:
                yield from ended()
        elif held:
            held.append(item)
    yield from ended()


def _parts(moves: Moves) -> Iterator[Moves]:
    """The moves in parts of about a piece's length."""
    at = np.cumsum(_durations(moves)) // PIECE
    cuts = [0, *(np.flatnonzero(np.diff(at)) + 1).tolist(), len(moves.line)]
    for low, high in pairwise(cuts):
        last = high == len(moves.line)
        yield replace(
            moves, line=moves.line[low:high], points=moves.points[low : high + 1],
            speed=moves.speed[low:high], acceleration=moves.acceleration[low:high],
            corner=moves.corner[low:high],
            marks=tuple(
                Mark(mark.index - low, mark.text)
                for mark in moves.marks
                if low <= mark.index < high or (last and mark.index == high)
            ),
        )  # fmt: skip


def _durations(moves: Moves) -> Array:
    length = np.sqrt(np.square(np.diff(moves.points[:, :E], axis=0)).sum(axis=1))
    return np.asarray(length / moves.speed)


def _seconds(moves: Moves, kinds: Integers) -> dict[str, float]:
    seconds = np.bincount(kinds, _durations(moves), len(NAMES))
    return {NAMES[k]: float(seconds[k]) for k in np.flatnonzero(seconds)}
