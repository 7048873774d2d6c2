"""What the firmware's input shapers would make of a print, for comparison."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np

from hframe_post.arrays import X, Y
from hframe_post.model.shapers import Shaping
from hframe_post.stream.chunks import neighbours, stretches
from hframe_post.stream.types import Samples, frozen

SHAPER = "shaper"  # stands among the names of strategies


def shape(chunks: Iterable[Samples], shapings: dict[str, Shaping]) -> Iterator[Samples]:
    """Yield the samples with the command of each shaper in addition to theirs."""
    pairs = {name: (s.x.shaper, s.y.shaper) for name, s in shapings.items()}
    reach = max((s.reach for pair in pairs.values() for s in pair), default=0)
    for stretch in stretches(chunks):
        for before, chunk, after in neighbours(stretch, reach, reach):
            around = [each.xyze for each in (*before, chunk, *after)]
            path = [np.concatenate([xyze[:, axis] for xyze in around]) for axis in (X, Y)]
            start, command = sum(map(len, before)), np.zeros((len(pairs), len(chunk), 2))
            for shapers, shaped in zip(pairs.values(), command, strict=True):
                for axis in (X, Y) if len(chunk) else ():
                    run = shapers[axis].run(path[axis])
                    shaped[:, axis] = run[start : start + len(chunk)]
            commands = dict(zip(pairs, frozen(command), strict=True))
            yield replace(chunk, commands={**chunk.commands, **commands})
