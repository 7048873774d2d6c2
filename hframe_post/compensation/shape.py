"""What the firmware's input shapers would make of a print, for comparison."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np

from hframe_post.arrays import X, Y, Z
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
            path = np.concatenate([each.xyze[:, :Z] for each in (*before, chunk, *after)])
            start = sum(map(len, before))
            where = slice(start, start + len(chunk))
            commands = {
                name: frozen(np.column_stack([x.run(path[:, X])[where], y.run(path[:, Y])[where]]))
                if len(path)
                else path
                for name, (x, y) in pairs.items()
            }
            yield replace(chunk, commands={**chunk.commands, **commands})
