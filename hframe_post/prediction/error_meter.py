"""Commands → the errors of the nozzle's path and of the printed line, summed up by strategy.

The width of the printed line is filament per length of the nozzle's way.

Filament comes out in step with the planned path. Where the nozzle lags, rings or cuts a corner, it
goes another way in the same time, so the line becomes too thick or too thin:

    w = Σ (de/dp) dp / Σ (de/dp) ds,   dp along the path, ds along the nozzle's way

over pieces of PIECE mm of the nozzle's way; w = 1 is the slicer's line. Where the samples say how
far the extruder is ahead, what comes out goes through the hot end's pressure (``Melt``); otherwise
pressure is not predicted.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from hframe_post.arrays import TS, Array, E, Integers
from hframe_post.firmware.motion import MotionRules
from hframe_post.model.nozzle import Plants
from hframe_post.model.plant import Plant
from hframe_post.model.pressure_advance import extruding
from hframe_post.native.judging import line_pieces
from hframe_post.native.linear import recursion
from hframe_post.native.stop import NEAREST
from hframe_post.prediction.doubts import Doubts
from hframe_post.prediction.predict import (
    COMPENSATING,
    Judgement,
    as_written,
    judge,
    judge_window,
)
from hframe_post.prediction.statistics import ContourErrors, ErrorStatistics
from hframe_post.prediction.windows import WINDOW, Windows
from hframe_post.stream.chunks import branches, on_a_grid
from hframe_post.stream.types import Samples

if TYPE_CHECKING:
    from hframe_post.prediction.picture import Picture


PIECE = 0.4  # mm, the width of a usual line


class Lines:
    """The lines that the nozzle draws with each strategy.

    Where E contains the advance, it does so for a strategy that compensates. The advance of the
    firmware, with which others are played there, is taken to make up for all pressure.
    """

    def __init__(self) -> None:
        self._melt = Melt()
        self._path: Array | None = None  # at the last sample, (1, 4)
        self._open: dict[str, tuple[Array, Array]] = {}  # the nozzle there (1, 2); its piece

    def pieces(self, judgement: Judgement) -> dict[str, tuple[Integers, Array]]:
        """Return by strategy where in the next chunk pieces end (k,), and |w − 1| of each."""
        chunk, found = judgement.chunk, dict[str, tuple[Integers, Array]]()
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
                at, errors, begun = line_pieces(*drawn, PIECE, begun)
                found[name] = np.maximum(at - 2, 0), errors  # the last sample of each
                self._open[name] = nozzle[-1:], begun
            self._path = chunk.xyze[-1:]
        if chunk.ends_stretch:
            self._path, self._melt = None, Melt()
            self._open.clear()
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
# Commands → the errors of the nozzle's path and of the printed line, summed up by strategy.

JUDGED_EVERY = 2  # samples; 500 Hz is far above what a printer rings at


class ErrorMeter:
    """Predicts the errors of the nozzle's path and line, by strategy: ``contour`` and ``width``.

    doubts: what is not known of the plant. picture: also collects them, if given. whole: samples
    from the first one on that are all judged, and a share of those after them; None: judge all.
    rules: of the lines that the commands become, if they do. judged: samples that were.
    """

    def __init__(
        self, plant: Plant, every: int = JUDGED_EVERY, doubts: Doubts | None = None,
        picture: Picture | None = None, whole: int | None = None, rules: MotionRules | None = None,
    ) -> None:  # fmt: skip
        self._plant, self._every, self._doubts, self._rules = plant, every, doubts, rules
        self._whole, self.judged = whole, 0
        self.picture, self._lines = picture, Lines()
        self.contour: dict[str, ContourErrors] = {}
        self.width: dict[str, ErrorStatistics] = {}

    def samples(self, chunks: Iterable[Samples]) -> Iterator[Samples]:
        if self._whole is None:
            kept, passed = branches(on_a_grid(chunks, WINDOW) if self._rules else chunks, 2)
            written = (as_written(chunk, self._rules) for chunk in passed)
            judged = judge(written, self._plant, self._every, self._doubts)
            for chunk, judgement in zip(kept, judged, strict=True):
                self._add(judgement, self._lines)
                if self.picture is not None:
                    self.picture.add(judgement)
                yield chunk
            return
        doubts, plants = self._doubts, Plants([self._plant])
        before = max(self._plant.memory, doubts.past if doubts is not None else 0, NEAREST)
        after = self._plant.ahead + NEAREST + 1 + (doubts.ahead if doubts is not None else 0)
        for chunk, windows in Windows(before, after, self._whole).samples(chunks):
            for each in windows:
                window = replace(each, piece=as_written(each.piece, self._rules))
                judgement = judge_window(window, plants, self._every, doubts)
                self._add(judgement, Lines(), each.weight)
            yield chunk

    def _add(self, judgement: Judgement, lines: Lines, weight: int = 1) -> None:
        self.judged += len(judgement.chunk)
        for name, errors in judgement.contour.items():
            contour = self.contour.setdefault(name, ContourErrors())
            contour.add(errors, judgement.extruding, weight)
            if name in judgement.products:
                extruding = judgement.extruding[judgement.doubtful]
                contour.doubt(judgement.products[name], extruding, weight)
        for name, (_, shares) in lines.pieces(judgement).items():
            self.width.setdefault(name, ErrorStatistics()).add(shares, weight)
