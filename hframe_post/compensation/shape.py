"""What the firmware itself would make of a print, for comparison: input shapers, or a kernel."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from typing import Protocol

import numpy as np

from hframe_post.arrays import Array, Z
from hframe_post.stream.chunks import neighbours, stretches
from hframe_post.stream.types import Samples, frozen

SHAPER, LIVE = "shaper", "live"  # stand among the names of strategies


class Shapes(Protocol):
    """A ``Shaping`` or a ``Kernel``: what depends on the path within ``reach`` samples."""

    @property
    def reach(self) -> int: ...

    def run(self, path: Array) -> Array:
        """Return the command (n, 2) for a path (n, 2) that is at rest before and after it."""


def shape(chunks: Iterable[Samples], shapings: Mapping[str, Shapes]) -> Iterator[Samples]:
    """Yield the samples with the command of each of these in addition to theirs."""
    reach = max((one.reach for one in shapings.values()), default=0)
    for stretch in stretches(chunks):
        for before, chunk, after in neighbours(stretch, reach, reach):
            path = np.concatenate([each.xyze[:, :Z] for each in (*before, chunk, *after)])
            start, end = (n := sum(map(len, before))), n + len(chunk)
            commands = {
                name: frozen(one.run(path)[start:end] if len(chunk) else np.zeros((0, 2)))
                for name, one in shapings.items()
            }
            yield replace(chunk, commands={**chunk.commands, **commands})
