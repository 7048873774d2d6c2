"""Predicts where the nozzle goes: commands through the plant, and how far off the path.

The plant is exact: states carried, and racking at the actual x (eq. 2), not at x_d. The
contour error is the distance to the path, not to where the nozzle should be at that time.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from hframe_post.arrays import Array, E, Flags, Integers, Z
from hframe_post.model.plant import Plant, Response
from hframe_post.model.stop import NEAREST
from hframe_post.prediction.contour import contour_error
from hframe_post.stream.chunks import stretches, with_neighbours
from hframe_post.stream.types import Samples, frozen


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
    (k,), distance to the path. tracking: strategy → (k, 2), off the desired place at the same
    time. All mm.
    """

    chunk: Samples
    at: Integers
    extruding: Flags
    contour: dict[str, Array]
    tracking: dict[str, Array]


def judge(chunks: Iterable[Samples], plant: Plant, every: int = 1) -> Iterator[Judgement]:
    """One judgement a chunk, of its samples in motion.

    Of the samples ``every`` second, third, … counts. Those at which the path stands are left
    out: nothing of it is traced there.
    """
    for stretch in stretches(chunks):
        originals: deque[Samples] = deque()
        predicted = _predicted(stretch, plant, originals)
        for chunk, wide, where in with_neighbours(predicted, NEAREST, NEAREST + 1):
            first = -chunk.first % every
            moving, extruding = (flags[where][first::every] for flags in in_motion(wide))
            here, path = np.arange(first, len(chunk), every), wide.xyze[:, :Z]
            contour, tracking = {}, {}
            for name, actual in chunk.commands.items():
                judged = actual[first::every]
                contour[name] = contour_error(path, judged, where.start + here)[moving]
                tracking[name] = (judged - chunk.xyze[first::every, :Z])[moving]
            yield Judgement(originals.popleft(), here[moving], extruding[moving], contour, tracking)


def _predicted(
    chunks: Iterable[Samples], plant: Plant, originals: deque[Samples]
) -> Iterator[Samples]:
    """The chunks with motion in place of commands; those with commands are remembered."""
    for chunk, actual in predict(chunks, plant):
        originals.append(chunk)
        motion = {name: frozen(xy) for name, xy in actual.items()}
        yield replace(chunk, commands=motion)


def in_motion(chunk: Samples) -> tuple[Flags, Flags]:
    """Samples to which the path moves, and those of them on whose way filament is laid, (n,)."""
    steps = np.diff(chunk.xyze, axis=0, prepend=chunk.xyze[:1])
    moving = (steps[:, :Z] != 0.0).any(axis=1)
    return moving, moving & (steps[:, E] > 0.0)
