"""Commands → the errors of the nozzle's path and of the printed line, summed up by strategy.

The width of the printed line is filament per length of the nozzle's way.

Filament comes out in step with the planned path. Where the nozzle lags, rings or cuts a corner, it
goes another way in the same time, so the line becomes too thick or too thin:

    w = Σ (de/dp) dp / Σ (de/dp) ds,   dp along the path, ds along the nozzle's way

over pieces of PIECE_MM of the nozzle's way; w = 1 is the slicer's line. Where the samples say how
far the extruder is ahead, what comes out goes through the hot end's pressure (``Melt``); otherwise
pressure is not predicted.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from hframe_post.arrays import TS, Array, E, Integers
from hframe_post.model.plant import Plant
from hframe_post.model.pressure_advance import extruding
from hframe_post.native.judging import line_pieces
from hframe_post.native.linear import recursion
from hframe_post.prediction.doubts import Doubts
from hframe_post.prediction.predict import COMPENSATING, Judge, Judgement, Played
from hframe_post.prediction.statistics import ContourErrors, ErrorStatistics
from hframe_post.prediction.windows import Window, Windows
from hframe_post.stream.types import Samples

if TYPE_CHECKING:
    from hframe_post.prediction.picture import Picture


PIECE_MM = 0.4  # the width of a usual line


class Lines:
    """The lines that the nozzle draws with each strategy.

    Where E contains the advance, it does so for a strategy that compensates. The advance of the
    firmware, with which others are played there, is taken to make up for all pressure.
    """

    def __init__(self) -> None:
        self._melt, self._end = Melt(), -1
        self._path: Array | None = None  # at the last sample, (1, 4)
        self._open: dict[str, tuple[Array, Array]] = {}  # the nozzle there (1, 2); its piece

    def pieces(self, judgement: Judgement) -> dict[str, tuple[Integers, Array]]:
        """Return by strategy where in the window pieces end (k,), and |w − 1| of each.

        Lines go on if it follows the one before.
        """
        chunk, found = judgement.chunk, dict[str, tuple[Integers, Array]]()
        if chunk.first != self._end:
            self._melt, self._path = Melt(), None
            self._open.clear()
        if len(chunk) and judgement.motion:
            before = chunk.xyze[:1] if self._path is None else self._path
            path = np.concatenate([before, chunk.xyze])
            planned = np.diff(path[:, E], prepend=path[0, E])
            laid = np.append(0.0, self._melt.laid(path, chunk.advance))
            ours = COMPENSATING if chunk.in_e else judgement.motion.keys()
            for name, nozzle in judgement.motion.items():
                last, begun = self._open.get(name, (nozzle[:1], np.zeros(4)))
                out = laid if name in ours else planned
                drawn = path, np.concatenate([last, nozzle]), out
                at, errors, begun = line_pieces(*drawn, PIECE_MM, begun)
                found[name] = np.maximum(at - 2, 0), errors  # the last sample of each
                self._open[name] = nozzle[-1:], begun
            self._path = chunk.xyze[-1:]
        self._end = -1 if chunk.ends_stretch else chunk.end
        return found


# ----------------------------------------------------------------------
# The flow out of the nozzle, which follows the extruder late: a filter of first order in pressure.
#
#     K dq/dt + q = d(E + A)/dt
#
# q is the flow (filament, mm/s), K the time that pressure advance is set to, A how far the extruder
# is ahead. Retractions are left out: they take back what they give. The simplest model is also the
# best that measurements of step responses support; see docs/identify.md.


class Melt:
    """What comes out along one stretch."""

    def __init__(self) -> None:
        self._held = 0.0  # mm of filament by which the hot end is compressed
        self._ahead = 0.0  # A at the last sample

    def laid(self, path: Array, advance: Array | None) -> Array:
        """Return the mm of filament (n,) that come out in the steps of a path (n + 1, 4).

        advance (n, 2): A and K at the ends of the steps; None: both are 0.
        """
        fed = np.where(extruding(path), np.diff(path[:, E]), 0.0)
        if advance is None:
            fed[0] += self._held
            self._held = self._ahead = 0.0
            return fed
        ahead, K = advance.T
        fed += np.diff(ahead, prepend=self._ahead)
        self._ahead = float(ahead[-1])
        cuts = [0, *(np.flatnonzero(np.diff(K)) + 1).tolist(), len(K)]
        parts = pairwise(cuts)
        return np.concatenate([self._part(fed[a:b], float(K[a])) for a, b in parts])

    def _part(self, fed: Array, K: float) -> Array:
        """Return what comes out in steps that feed this much, with one K."""
        kept = np.exp(-TS / K) if K else 0.0
        fed[0] += self._held
        laid = recursion(np.array([[kept]]), (1.0 - kept) * fed[:, None], np.zeros(1))[1:]
        self._held = float(laid[-1]) * kept / (1.0 - kept)
        return laid


# ----------------------------------------------------------------------

JUDGED_EVERY = 2  # samples; 500 Hz is far above what a printer rings at


class ErrorMeter:
    """Predicts the errors of the nozzle's path and line, by strategy: ``contour`` and ``width``.

    doubts: what is not known of the plant. whole: samples from the first one on that are all
    judged, and a share of those after them; None: judge all. picture: collects all of the print, if
    given, also without compensation. played: of commands of which lines are written while the
    chunks pass; then call ``end`` once they are. judged: samples that were.
    """

    def __init__(
        self, plant: Plant, every: int = JUDGED_EVERY, doubts: Doubts | None = None,
        picture: Picture | None = None, whole: int | None = None, played: Sequence[Played] = (),
    ) -> None:  # fmt: skip
        self.judge, self._played, self._whole = Judge(plant, every, doubts), played, whole
        self.picture, self._lines, self.judged = picture, Lines(), 0
        self.contour: dict[str, ContourErrors] = {}
        self.width: dict[str, ErrorStatistics] = {}
        self._windows, self._waiting = self._cut(), deque[Samples]()

    def samples(self, chunks: Iterable[Samples]) -> Iterator[Samples]:
        """Yield the chunks unchanged, and add their errors: once lines are written of them."""
        for chunk in chunks:
            yield chunk
            self._waiting.append(chunk)
            while self._waiting and self._is_played(self._waiting[0]):
                self._take(self._waiting.popleft())
        if not self._played:
            self.end()

    def end(self) -> None:
        """Add the errors of what is left of the stream."""
        while self._waiting:
            self._take(self._waiting.popleft())
        for window in self._windows.end():
            self.add(window)
        self._windows = self._cut()

    def _cut(self) -> Windows:
        shown = self.picture is not None
        return Windows(self.judge.before, self.judge.after, self._whole, shown)

    def _is_played(self, chunk: Samples) -> bool:
        return all(chunk.end <= each.until for each in self._played)

    def _take(self, chunk: Samples) -> None:
        for window in self._windows.take(chunk):
            self.add(window)

    def add(self, window: Window) -> None:
        judgement = self.judge.judged(window, self._played, sliced=self.picture is not None)
        if self.picture is not None:
            self.picture.add(judgement)
        weight = window.weight
        if not weight:
            return
        self.judged += window.stop - window.start
        for name, errors in judgement.contour.items():
            contour = self.contour.setdefault(name, ContourErrors())
            contour.add(errors, judgement.extruding, weight)
            if name in judgement.products:
                extruding = judgement.extruding[judgement.doubtful]
                contour.doubt(judgement.products[name], extruding, weight)
        for name, (_, shares) in self._lines.pieces(judgement).items():
            self.width.setdefault(name, ErrorStatistics()).add(shares, weight)
