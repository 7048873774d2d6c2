"""Predicts where the nozzle goes: commands through the plant, and how far off the path.

The plant is exact: states carried, and racking at the actual x (eq. 2), not at x_d. The
contour error is the distance to the path, not to where the nozzle should be at that time.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from hframe_post.arrays import Array, Flags, Integers, Z
from hframe_post.model.plant import Plant, Response
from hframe_post.prediction.contour import NEAREST, contour_error
from hframe_post.stream.chunks import stretches, with_neighbours
from hframe_post.stream.types import Pause, Rest, Samples, frozen


def predict(blocks: Iterable[Samples], plant: Plant) -> Iterator[tuple[Samples, dict[str, Array]]]:
    """Each block and, for every strategy in its commands, the nozzle's x, y (n, 2)."""
    for stretch in stretches(blocks):
        responses: dict[str, Response] = {}
        for block in stretch:
            if len(block) and not responses:
                responses = {name: Response(plant, block.xyze[0, :Z]) for name in block.commands}
            yield block, {name: r.run(block.commands[name]) for name, r in responses.items()}


@dataclass(frozen=True, slots=True)
class Judgement:
    """How well each strategy follows one block; k of its samples count.

    at (k,): which samples of the block. contour: strategy → (k,), distance to the path.
    tracking: strategy → (k, 2), off the desired place at the same time. All mm.
    """

    block: Samples
    at: Integers
    contour: dict[str, Array]
    tracking: dict[str, Array]


def judge(blocks: Iterable[Samples], plant: Plant, every: int = 1) -> Iterator[Judgement]:
    """One judgement a block, of its samples in motion.

    Of the samples ``every`` second, third, … counts. Those at which the machine rests for
    something else are left out: nothing of the path is traced there.
    """
    for stretch in stretches(blocks):
        originals: deque[Samples] = deque()
        predicted = _predicted(stretch, plant, originals)
        for block, wide, where in with_neighbours(predicted, NEAREST, NEAREST + 1):
            first = -block.first % every
            moving = in_motion(block)[first::every]
            here, path = np.arange(first, len(block), every), wide.xyze[:, :Z]
            contour, tracking = {}, {}
            for name, actual in block.commands.items():
                judged = actual[first::every]
                contour[name] = contour_error(path, judged, where.start + here)[moving]
                tracking[name] = (judged - block.xyze[first::every, :Z])[moving]
            yield Judgement(originals.popleft(), here[moving], contour, tracking)


def _predicted(
    blocks: Iterable[Samples], plant: Plant, originals: deque[Samples]
) -> Iterator[Samples]:
    """The blocks with motion in place of commands; those with commands are remembered."""
    for block, actual in predict(blocks, plant):
        originals.append(block)
        motion = {name: frozen(xy) for name, xy in actual.items()}
        yield Samples(block.first, block.xyze, block.line, block.events, motion)


def in_motion(block: Samples) -> Flags:
    """Samples that are not part of a rest or pause, (n,)."""
    moving = np.ones(len(block), dtype=bool)
    for event in block.events:
        if isinstance(event, Rest | Pause):
            start = event.index - block.first
            moving[start : start + event.samples] = False
    return moving
