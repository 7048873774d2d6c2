"""Width of the printed line: filament per length of the nozzle's way.

Filament comes out in step with the planned path. Where the nozzle lags, rings or cuts a corner, it
goes another way in the same time, so the line becomes too thick or too thin:

    w = Σ (de/dp) dp / Σ (de/dp) ds,   dp along the path, ds along the nozzle's way

over pieces of PIECE mm of the nozzle's way; w = 1 is the slicer's line. Where the samples say how
far the extruder is ahead, what comes out goes through the hot end's pressure (``melt``); otherwise
pressure is not predicted.
"""

from __future__ import annotations

import numpy as np

from hframe_post.arrays import Array, E, Integers
from hframe_post.model.strategies import STRATEGIES
from hframe_post.native.line_width import line_pieces
from hframe_post.prediction.melt import Melt
from hframe_post.prediction.predict import Judgement

PIECE = 0.4  # mm, the width of a usual line
COMPENSATING = STRATEGIES.keys() - {"none"}


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
