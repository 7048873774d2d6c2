"""What studies print: the paper's rectangle, or an excerpt of a print.

An excerpt is pieces of some seconds, a minute or two in total. The time kept of each kind of
feature is a share of the whole, larger for rare kinds. Once too much is kept, every other piece is
dropped and the share is halved, so that memory does not grow with the print.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from hframe_post.arrays import Array, E
from hframe_post.firmware.dialect import NO_ADVANCE, Advance
from hframe_post.planner.pacing import NAMES, Labeller, PieceStart
from hframe_post.printer.settings import Printer
from hframe_post.stream.features import TRAVEL
from hframe_post.stream.marks import Marks
from hframe_post.stream.types import Item, MoveAtRest, Moves, Passthrough

PIECE = 3.0  # s at the file's feed rates
SECONDS = 40.0, 100.0  # least and most to keep of a print
SHARE = 0.03  # of a print to keep; up to twice as much is kept


@dataclass(frozen=True, slots=True)
class Piece:
    """Items between two stops.

    seconds: by feature, at the file's feed rates. advance: pressure advance at its beginning.
    """

    start: PieceStart
    items: tuple[Item, ...]
    seconds: dict[str, float]
    advance: Advance


def excerpt(
    items: Iterable[Item], first_layers: int = 1, seconds: tuple[float, float] = SECONDS,
    advance: Advance = NO_ADVANCE,
) -> list[Piece]:  # fmt: skip
    """Return pieces of a print, or all of it if it is short, without its first layers.

    seconds: least and most to keep; up to twice as much may be kept. advance: pressure advance
    until the file sets another.
    """
    pieces, share = list[Piece](), 1.0
    seen, kept = defaultdict[str, float](float), defaultdict[str, float](float)
    for piece in _pieces(items, first_layers, advance):
        _add(seen, piece.seconds)
        total = sum(seen.values())
        if any(  # it has 0.2 s of a feature of which little was kept
            here > 0.2 and kept.get(name, 0.0) < share * np.sqrt(seen[name] * total)
            for name, here in piece.seconds.items()
        ):
            pieces.append(piece)
            _add(kept, piece.seconds)
        enough = min(max(SHARE * total, seconds[0]), seconds[1])
        while sum(kept.values()) > 2.0 * enough and len(pieces) > 1:
            pieces, share = pieces[::2], share / 2.0
            kept.clear()
            for left in pieces:
                _add(kept, left.seconds)
    return pieces


@dataclass(frozen=True, slots=True)
class Section:
    """Items between two stops. layers: the numbers of all that are printed in them, in order."""

    start: PieceStart
    items: tuple[Item, ...]
    layers: tuple[int, ...]


def sections(items: Iterable[Item], first_layers: int = 1) -> Iterator[Section]:
    """Yield the whole print in sections; each ends at the first stop after the layer changes."""
    labeller = Labeller(PieceStart())
    start, collected = labeller.start, list[Item]()
    for item in items:
        rests = not isinstance(item, Moves) and (isinstance(item, MoveAtRest | Passthrough))
        now = labeller.start
        if rests and collected and now.place.layer != start.place.layer:
            yield Section(start, tuple(collected), _layers(start, now))
            start, collected = now, []
        if isinstance(item, Moves):
            labeller.classify(item, first_layers)
        else:
            labeller.pass_by(item)
        collected.append(item)
    yield Section(start, tuple(collected), _layers(start, labeller.start))


def _layers(start: PieceStart, end: PieceStart) -> tuple[int, ...]:
    return tuple(range(start.place.layer, end.place.layer + 1))


def useful_feeds(pieces: Iterable[Piece], velocity: float, flow: float) -> dict[str, float]:
    """Return the factor on each feature's feed rates that 98 % of its path can make use of.

    velocity: greatest speed of the path, mm/s; flow: greatest feed of filament, mm/s.
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
    useful = {}
    for name, parts in factors.items():
        rows = np.concatenate(parts, axis=1)
        factor, length = rows[:, np.argsort(rows[0])]
        way = np.cumsum(length)
        useful[name] = float(factor[np.searchsorted(way, 0.98 * way[-1])])
    return useful


def _add(total: defaultdict[str, float], seconds: dict[str, float]) -> None:
    for name, more in seconds.items():
        total[name] += more


def _pieces(items: Iterable[Item], first_layers: int, advance: Advance) -> Iterator[Piece]:
    """Yield the print in pieces. Lines that the machine must take at rest are between them."""
    labeller = Labeller(PieceStart())
    start, collected, seconds = labeller.start, list[Item](), defaultdict[str, float](float)
    begun = advance

    def ended() -> Iterator[Piece]:
        nonlocal start, collected, seconds, begun
        if any(name != TRAVEL for name in seconds):
            yield Piece(start, tuple(collected), dict(seconds), begun)
        start, collected, seconds = labeller.start, [], defaultdict(float)
        begun = advance

    for item in items:
        if isinstance(item, Moves):
            for part, durations in _parts(item):
                kinds, _, first = labeller.classify(part, first_layers)
                for mark in part.marks.said():
                    advance = advance.after(mark.text)
                if first.any():
                    yield from ended()
                    continue
                collected.append(part)
                present = np.bincount(kinds, durations, len(NAMES))
                _add(seconds, {NAMES[k]: float(present[k]) for k in np.flatnonzero(present)})
                if sum(seconds.values()) >= PIECE:
                    yield from ended()
        elif isinstance(item, Marks):
            labeller.pass_by(item)
            for mark in item.said():
                advance = advance.after(mark.text)
            collected.append(item)
        elif isinstance(item, Passthrough):
            labeller.pass_by(item)
            advance = advance.after(item.text)
            yield from ended()
        elif collected:
            collected.append(item)
    yield from ended()


def _parts(moves: Moves) -> Iterator[tuple[Moves, Array]]:
    """Yield the moves in parts of about a piece's duration, with the seconds of each move."""
    durations = _durations(moves)
    at = np.cumsum(durations) // PIECE
    if at[-1] == at[0]:
        yield moves, durations
        return
    cuts = [0, *(np.flatnonzero(np.diff(at)) + 1).tolist(), len(moves.line)]
    for low, high in pairwise(cuts):
        last = high == len(moves.line)
        part = replace(
            moves, line=moves.line[low:high], points=moves.points[low : high + 1],
            speed=moves.speed[low:high], acceleration=moves.acceleration[low:high],
            corner=moves.corner[low:high],
            marks=moves.marks.rows(
                moves.marks.count_before(low), moves.marks.count_before(high + last)
            ).shifted(-low),
        )  # fmt: skip
        yield part, durations[low:high]


def _durations(moves: Moves) -> Array:
    length = np.sqrt(np.square(np.diff(moves.points[:, :E], axis=0)).sum(axis=1))
    return np.asarray(length / moves.speed)


def rectangle(printer: Printer) -> list[bytes]:
    """Return the paper's Fig. 7: 120 × 20 mm at 150 mm/s and 1e4 mm/s², at rest at the corners.

    It begins where racking does not move the nozzle, as in the paper, unless the bed is too
    narrow for that, and is centred on the bed in y.
    """
    low, high = printer.travel.x
    width, clear = 120, 5  # mm; the command needs some travel beyond its path
    x = max(min(printer.plant.x_c, high - width - clear), low + clear)
    y = round(sum(printer.travel.y) / 2.0) - 10
    corners = ((x + width, y), (x + width, y + 20), (x, y + 20), (x, y))
    lines = ["G28", "M83", "M204 S10000", "M205 X0 Y0 J0"]  # Marlin with either kind of corners
    lines += ["SET_VELOCITY_LIMIT SQUARE_CORNER_VELOCITY=0"]  # Klipper
    lines += ["G1 Z0.2 F600", f"G0 X{x:g} Y{y:g} F9000", ";LAYER:0", ";TYPE:WALL-OUTER"]
    lines += [
        f"G1 X{x:g} Y{y:g} E{length:g}"
        for (x, y), length in zip(corners, (4, 0.7, 4, 0.7), strict=True)
    ]
    return [line.encode() + b"\n" for line in lines]
