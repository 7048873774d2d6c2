"""Which layer and feature each sample belongs to, as the slicer's comments tell."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from hframe_post.arrays import E, Integers
from hframe_post.stream.features import Place
from hframe_post.stream.types import Mark, Passthrough, Pause, Samples

BEFORE = "before the first"  # layer or feature of what no comment precedes
TRAVEL = "TRAVEL"  # motion that lays down nothing, whatever the comment before it says


@dataclass
class Labels:
    """Names by number, and those in force where the last chunk ended.

    place: where the print is before the first of them. by_name: layers of one name are one,
    whatever is printed between them; else each has its number by place in the print, from 1.
    """

    place: Place = field(default_factory=Place)
    by_name: bool = True
    layers: list[str] = field(default_factory=lambda: [BEFORE])
    features: list[str] = field(default_factory=lambda: [TRAVEL, BEFORE])
    _e: float = -np.inf  # filament of the sample before

    def of(self, chunk: Samples) -> tuple[Integers, Integers]:
        """Numbers of the layer and the feature of each sample of the next chunk, (n,) each."""
        n = len(chunk)
        layer, feature = (np.full(n, number) for number in self._numbers())
        for event in chunk.events:
            if isinstance(event, Mark):
                text = event.text
            elif isinstance(event, Pause) and isinstance(event.action, Passthrough):
                text = event.action.text
            else:
                continue
            if self.place.mark(text):
                at = max(event.index - chunk.first, 0)
                layer[at:], feature[at:] = self._numbers()
        if n:
            e = chunk.xyze[:, E]
            feature[np.diff(e, prepend=self._e) <= 0.0] = 0
            self._e = float(e[-1])
        return layer, feature

    def _numbers(self) -> tuple[int, int]:
        """Of the present layer and feature."""
        named = _number(self.layers, self.place.name or BEFORE)
        layer = named if self.by_name else self.place.layer
        return layer, _number(self.features, self.place.feature or BEFORE)


def _number(names: list[str], name: str) -> int:
    if name not in names:
        names.append(name)
    return names.index(name)
