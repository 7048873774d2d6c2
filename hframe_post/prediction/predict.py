"""Predicts where the nozzle goes: commands through the plant, and how far off the path.

The plant is exact: states carried, and racking at the actual x (eq. 2), not at x_d. The
contour error is the distance to the path, not to where the nozzle should be at that time.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from hframe_post.arrays import Array, Flags, Integers, Z
from hframe_post.model.plant import Plant, Response
from hframe_post.model.stop_cost import NEAREST
from hframe_post.prediction.contour import contour_error
from hframe_post.stream.chunks import stretches, with_neighbours
from hframe_post.stream.types import Samples


def predict(chunks: Iterable[Samples], plant: Plant) -> Iterator[tuple[Samples, dict[str, Array]]]:
    """Each chunk and, for every strategy in its commands, the nozzle's x, y (n, 2)."""
    for stretch in stretches(chunks):
        responses: dict[str, Response] = {}
        for chunk in stretch:
            if len(chunk) and not responses:
                responses = {name: Response(plant, chunk.xyze[0, :Z]) for name in chunk.commands}
            yield chunk, {name: r.run(chunk.commands[name]) for name, r in responses.items()}


@dataclass(frozen=True, slots=True)
class Judgement:
    """How well each strategy follows one chunk; k of its samples count.

    at (k,): which samples of the chunk; extruding (k,): which of these. contour: strategy →
    (k,), distance to the path. motion: strategy → the nozzle's x, y (n, 2) at all samples. mm.
    """

    chunk: Samples
    at: Integers
    extruding: Flags
    contour: dict[str, Array]
    motion: dict[str, Array]

    def tracking(self, strategy: str) -> Array:
        """How far off the desired place at the same time, (k, 2), mm."""
        return np.asarray(self.motion[strategy][self.at] - self.chunk.xyze[self.at, :Z])


def judge(chunks: Iterable[Samples], plant: Plant, every: int = 1) -> Iterator[Judgement]:
    """One judgement a chunk, of its samples in motion.

    Of the samples ``every`` second, third, … counts. Those at which the path stands are left
    out: nothing of it is traced there.
    """
    for stretch in stretches(chunks):
        predicted: deque[tuple[Samples, dict[str, Array]]] = deque()
        paths = _paths(predict(stretch, plant), predicted)
        for _, wide, where in with_neighbours(paths, NEAREST, NEAREST + 1):
            chunk, motion = predicted.popleft()
            first = -chunk.first % every
            moving, extruding = (flags[where][first::every] for flags in in_motion(wide.xyze))
            here, path = np.arange(first, len(chunk), every), wide.xyze[:, :Z]
            contour = {
                name: contour_error(path, xy[first::every], where.start + here)[moving]
                for name, xy in motion.items()
            }
            yield Judgement(chunk, here[moving], extruding[moving], contour, motion)


def _paths(
    predicted: Iterable[tuple[Samples, dict[str, Array]]],
    taken: deque[tuple[Samples, dict[str, Array]]],
) -> Iterator[Samples]:
    """The path alone of each chunk, which is remembered with its motion."""
    for chunk, motion in predicted:
        taken.append((chunk, motion))
        yield replace(chunk, events=(), commands={})


def in_motion(xyze: Array) -> tuple[Flags, Flags]:
    """Samples to which the path xyze (n, 4) moves, those on whose way filament is laid, (n,)."""
    moving, extruding = np.zeros((2, len(xyze)), dtype=bool)
    x, y, _, e = xyze.T
    moving[1:] = (x[1:] != x[:-1]) | (y[1:] != y[:-1])
    extruding[1:] = moving[1:] & (e[1:] > e[:-1])
    return moving, extruding
