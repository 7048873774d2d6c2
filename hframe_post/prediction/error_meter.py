"""Commands → the errors of the nozzle's path and of the printed line, summed up by strategy."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING

from hframe_post.model.plant import Plant
from hframe_post.model.responses import Plants
from hframe_post.native.stop import NEAREST
from hframe_post.prediction.doubts import Doubts
from hframe_post.prediction.line_width import Lines
from hframe_post.prediction.predict import Judgement, judge, judge_window
from hframe_post.prediction.statistics import ContourErrors, ErrorStatistics
from hframe_post.prediction.windows import Windows
from hframe_post.stream.types import Samples

if TYPE_CHECKING:
    from hframe_post.prediction.picture import Picture

JUDGED_EVERY = 2  # samples; 500 Hz is far above what a printer rings at


class ErrorMeter:
    """Predicts the errors of the nozzle's path and line, by strategy: ``contour`` and ``width``.

    doubts: what is not known of the plant. picture: also collects them, if given. whole: samples
    from the first one on that are all judged, and a share of those after them; None: judge all.
    judged: samples that were.
    """

    def __init__(
        self, plant: Plant, every: int = JUDGED_EVERY, doubts: Doubts | None = None,
        picture: Picture | None = None, whole: int | None = None,
    ) -> None:  # fmt: skip
        self._plant, self._every, self._doubts = plant, every, doubts
        self._whole, self.judged = whole, 0
        self.picture, self._lines = picture, Lines()
        self.contour: dict[str, ContourErrors] = {}
        self.width: dict[str, ErrorStatistics] = {}

    def samples(self, chunks: Iterable[Samples]) -> Iterator[Samples]:
        if self._whole is None:
            for judgement in judge(chunks, self._plant, self._every, self._doubts):
                self._add(judgement, self._lines)
                if self.picture is not None:
                    self.picture.add(judgement)
                yield judgement.chunk
            return
        doubts, plants = self._doubts, Plants([self._plant])
        before = max(self._plant.memory, doubts.past if doubts is not None else 0, NEAREST)
        after = self._plant.ahead + NEAREST + 1 + (doubts.ahead if doubts is not None else 0)
        for chunk, windows in Windows(before, after, self._whole).samples(chunks):
            for each in windows:
                judgement = judge_window(each, plants, self._every, doubts)
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
