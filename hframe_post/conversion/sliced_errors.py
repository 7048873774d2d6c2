"""What a print has today: the errors of the firmware's own motion of the file as sliced.

They are predicted without compensation and with the firmware's best input shaper, on pieces from
all over the print: a print of any length needs four minutes of motion at most.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from operator import itemgetter

import numpy as np

from hframe_post.arrays import TS, Array, E
from hframe_post.compensation.shape import SHAPER, shape
from hframe_post.firmware.base import Firmware
from hframe_post.firmware.registry import firmware
from hframe_post.model.plant import Plant
from hframe_post.model.shapers import Shaping
from hframe_post.planner.parts import part
from hframe_post.planner.sliced import AsSliced, Timed
from hframe_post.prediction.best_shaper import Paths, paths, ranked
from hframe_post.prediction.error_meter import ErrorMeter
from hframe_post.prediction.predict import quantise
from hframe_post.prediction.statistics import ContourErrors, ErrorStatistics
from hframe_post.printer.settings import Printer
from hframe_post.stream.chunks import ended, successive
from hframe_post.stream.marks import Marks
from hframe_post.stream.types import Handling, Item, Passthrough, Plan, Samples, frozen

PIECE_S = 3.0  # of motion in a piece; more only if a single run lasts longer, 4 times at most
KEPT_S = 120.0  # to keep of a print; at most twice as much is kept
SHAPED_PIECES = 4  # pieces on which the shaper is chosen: its error is within 5 % of that on all

Piece = tuple[float, tuple[Plan | Passthrough, ...]]  # its seconds, and what it consists of


@dataclass(frozen=True, slots=True)
class Today:
    """Predicted print as sliced. shaping: of the best input shaper; None if nothing is extruded.

    contour, width: without compensation (none) and with the shaper. share: of the print's motion,
    on which they are predicted.
    """

    shaping: Shaping | None
    contour: dict[str, ContourErrors]
    width: dict[str, ErrorStatistics]
    share: float


class SlicedFile:
    """The firmware's own motion of the items that pass: their time, and pieces of the motion."""

    def __init__(self, printer: Printer, own: Firmware | None = None) -> None:
        self._firmware = own or firmware(printer)
        self._printer, self.own = printer, AsSliced(self._firmware.limits())
        self._pieces, self._every, self._count = list[Piece](), 1, 0
        self._piece, self._seconds = list[Plan | Passthrough](), 0.0  # of motion
        self._total, self._extrudes = 0.0, False  # seconds of all pieces that count

    @classmethod
    def from_items(cls, items: Iterable[Item], printer: Printer) -> SlicedFile:
        """Return what was kept of all items."""
        sliced = cls(printer)
        for _ in sliced.items(items):
            pass
        return sliced

    def items(self, items: Iterable[Item]) -> Iterator[Item]:
        for item in items:
            self._keep(self.own.timed(item))
            yield item
        self._keep(self.own.timed(None))
        self._end()

    @cached_property
    def paths(self) -> Paths:
        """Return the motion of a few pieces, once all items have passed."""
        return paths(self._samples(self._pieces[:: max(len(self._pieces) // SHAPED_PIECES, 1)]))

    def today(self) -> Today:
        """Return the errors of the pieces, once all items have passed."""
        shaping = self.shaping(self._printer.plant)
        meter, samples = ErrorMeter(self._printer.plant), self._samples(self._pieces)
        shaped = shape(samples, {} if shaping is None else {SHAPER: shaping})
        if (steps := self._firmware.steps) is not None:
            shaped = quantise(shaped, self._printer.kinematics, steps)
        for _ in meter.samples(shaped):
            pass
        share = self._kept / self._total if self._total else 1.0
        return Today(shaping, meter.contour, meter.width, share)

    def shaping(self, plant: Plant) -> Shaping | None:
        """Return about the best input shaper of the firmware; None if nothing is extruded."""
        if not self.paths:
            return None
        return ranked(plant, self.paths, self._firmware.shapers)[0]

    def _samples(self, pieces: Iterable[Piece]) -> Iterator[Samples]:
        return successive(ended(self._motion(piece)) for _, piece in pieces)

    def _motion(self, piece: tuple[Plan | Passthrough, ...]) -> Iterator[Samples]:
        """Yield a piece's samples, not many more than it may have.

        Of a piece that begins in motion the first samples do not count: they extrude nothing.
        """
        first, most = piece[0], round(4.0 * PIECE_S / TS)
        # after 300 samples it does not matter how it began
        lead = 300 if isinstance(first, Plan) and first.speed[0] else 0
        for chunk in self.own.sampled(piece, most // 4):
            if lead and len(chunk):
                xyze = chunk.xyze.copy()
                xyze[:lead, E] = xyze[min(lead, len(chunk)) - 1, E]
                chunk, lead = replace(chunk, xyze=frozen(xyze)), 0
            yield chunk
            if (most := most - len(chunk)) <= 0:
                return

    def _keep(self, planned: Iterable[Timed | Passthrough | Marks]) -> None:
        for item in planned:
            if isinstance(item, tuple):
                self._cut(*item)
            elif isinstance(item, Passthrough):
                if item.handling is Handling.RELEASE:
                    self._end()
                else:
                    self._piece.append(item)

    def _cut(self, plan: Plan, seconds: Array) -> None:
        """Add a plan to the piece, and end that wherever it is long enough."""
        low, passed = 0, [0.0, *seconds.cumsum().tolist()]
        begun = 0.0
        for high in _ends(seconds):
            self._seconds += passed[high] - begun
            begun = passed[high]
            if self._seconds >= PIECE_S:
                self._add(plan, low, high)
                self._end()
                low = high
        self._add(plan, low, len(seconds))

    def _add(self, plan: Plan, low: int, high: int) -> None:
        if high > low:
            first, last = plan.ends[[low, high]].tolist()
            k, end = (bisect_left(plan.standing, at, key=itemgetter(0)) for at in (first, last))
            standing = tuple((index - first, item) for index, item in plan.standing[k:end])
            own = replace(part(plan, first, last), standing=standing)
            self._piece.append(own)

    def _end(self) -> None:
        """End the piece; keep every n-th that extrudes anything, or every n-th if no piece does."""
        piece, seconds = tuple(self._piece), self._seconds
        self._piece, self._seconds = [], 0.0
        plans = [item.points for item in piece if isinstance(item, Plan)]
        extrudes = any(map(_extrudes, plans))
        if extrudes and not self._extrudes:
            self._pieces, self._every, self._count, self._total = [], 1, 0, 0.0
            self._extrudes = True
        if not plans or extrudes < self._extrudes:
            return
        if self._count % self._every == 0:
            self._pieces.append((seconds, piece))
        self._count += 1
        self._total += seconds
        while self._kept > 2.0 * KEPT_S and len(self._pieces) > 1:
            self._pieces, self._every = self._pieces[::2], 2 * self._every

    @property
    def _kept(self) -> float:
        return sum(seconds for seconds, _ in self._pieces)


def _ends(seconds: Array) -> Iterator[int]:
    """Yield before which runs (r,) a piece may end: at rest, or in motion of a piece's duration."""
    low = 0
    for rest in (*np.flatnonzero(seconds == 0.0).tolist(), len(seconds)):
        passed = seconds[low:rest].cumsum()
        if rest > low and passed[-1] >= PIECE_S:
            yield from (np.flatnonzero(np.diff(passed // PIECE_S)) + low + 1).tolist()
        yield rest
        low = rest + 1


def _extrudes(points: Array) -> bool:
    """Return whether a move between points (n + 1, 4) extrudes while x or y moves."""
    x, y, _, e = np.diff(points, axis=0).T
    return bool(((e > 0.0) & ((x != 0.0) | (y != 0.0))).any())
