"""Layers that must not be over too soon: the feeds that leave each its time to cool."""

from __future__ import annotations

from dataclasses import dataclass, replace

from hframe_post.studies.speed.drive import Drive, Original
from hframe_post.studies.speed.trial import Driven, Freedom

PLANNED = 6  # times that the layers' least times are planned, at most; it costs a tenth of a trial
SLOWEST_LAYER = 0.05  # least factor on the feed of a layer
AMPLE = 1.01  # times its least time that a slowed layer is given
STEEPER = 1.3  # power of a layer's share of its time: not all of it is spent at the feed
IN_TIME = 0.98  # share of a layer's least time that counts as all of it


@dataclass(frozen=True, slots=True)
class Cooling:
    """The least time of each layer, by place in the print: no less than the file gives it."""

    least: dict[int, float]

    @classmethod
    def of(cls, original: Original, freedom: Freedom) -> Cooling:
        """As long as may be asked of the file's own layers."""
        most = freedom.min_layer_time
        return cls({layer: min(own, most) for layer, own in original.layers.items() if layer})

    def short(self, layers: dict[int, float]) -> dict[int, float]:
        """The layers that are over too soon: shares of their least time."""
        return {
            layer: seconds / self.least[layer]
            for layer, seconds in layers.items()
            if seconds < IN_TIME * self.least.get(layer, 0.0)
        }

    def slowed(self, driven: Driven, layers: dict[int, float]) -> Driven:
        """With other feeds in layers that took less than their time."""
        factors = {
            layer: max(driven.slowed.get(layer, 1.0) * (share / AMPLE) ** STEEPER, SLOWEST_LAYER)
            for layer, share in self.short(layers).items()
        }
        return replace(driven, slowed={**driven.slowed, **factors})

    def planned(self, drive: Drive, driven: Driven) -> Driven:
        """With feeds at which the plan leaves each layer its time."""
        for _ in range(PLANNED):
            layers = drive.layers(driven)
            if not self.short(layers):
                break
            driven = self.slowed(driven, layers)
        return driven
