"""Which layer and feature each sample belongs to, as the slicer's comments tell."""

from __future__ import annotations

import re
from dataclasses import dataclass, field

import numpy as np

from hframe_post.arrays import E, Integers
from hframe_post.stream.types import Mark, Passthrough, Pause, Samples

BEFORE = "before the first"  # layer or feature of what no comment precedes
TRAVEL = "TRAVEL"  # motion that lays down nothing, whatever the comment before it says

_LAYER = re.compile(
    rb"\s*;[\s;(<\[-]*(?:layer[\s:#]+(?P<number>-?\d{1,9})(?![\d.])"  # Cura, ideaMaker, Kiri:Moto
    rb"|layer num/total_layer_count:\s*(?P<counted>\d{1,9})(?!\d)"  # Bambu Studio, from 1
    rb"|(?:LAYER_CHANGE|CHANGE_LAYER)\s*$"  # PrusaSlicer and its relatives
    rb"|BEGIN_LAYER_OBJECT z=|layer:\d+\.\d)"  # KISSlicer; FlashPrint, by height
    rb"|\s*[;(]\s*Slice (?P<slice>\d{1,9})(?=[, ])",  # MakerBot and Sailfish
    re.IGNORECASE,
)
_FEATURE = re.compile(
    rb"\s*;\s*(?:(?:TYPE|FEATURE):|feature (?=[a-z])|structure:)\s*(.*\S)"  # also Simplify3D
    rb"|\s*;\s*'([^']+)', [\d.]+ \[feed"  # KISSlicer
)


@dataclass
class Labels:
    """Names by number, and those in force where the last chunk ended.

    Some slicers number their layers (``;LAYER:0``); where one only says that a layer begins
    (``;LAYER_CHANGE``) they are counted from 0.
    """

    layers: list[str] = field(default_factory=lambda: [BEFORE])
    features: list[str] = field(default_factory=lambda: [TRAVEL, BEFORE])
    _layer: int = 0
    _feature: int = 1
    _e: float = -np.inf  # filament of the sample before

    def of(self, chunk: Samples) -> tuple[Integers, Integers]:
        """Numbers of the layer and the feature of each sample of the next chunk, (n,) each."""
        n = len(chunk)
        layer, feature = np.full(n, self._layer), np.full(n, self._feature)
        for event in chunk.events:
            if isinstance(event, Mark):
                text = event.text
            elif isinstance(event, Pause) and isinstance(event.action, Passthrough):
                text = event.action.text
            else:
                continue
            at = max(event.index - chunk.first, 0)
            if match := _LAYER.match(text):
                self._layer = _number(self.layers, self._named(match))
                layer[at:] = self._layer
            elif match := _FEATURE.match(text):
                self._feature = _number(
                    self.features, (match[1] or match[2]).decode("utf-8", "replace")
                )
                feature[at:] = self._feature
        if n:
            e = chunk.xyze[:, E]
            feature[np.diff(e, prepend=self._e) <= 0.0] = 0
            self._e = float(e[-1])
        return layer, feature

    def _named(self, match: re.Match[bytes]) -> str:
        if match["counted"] is not None:
            return str(int(match["counted"]) - 1)
        number = match["number"] or match["slice"]
        if number is not None:
            return number.decode()
        before = self.layers[self._layer]
        return "0" if before == BEFORE else str(int(before) + 1)


def _number(names: list[str], name: str) -> int:
    if name not in names:
        names.append(name)
    return names.index(name)
