"""Least times of layers: feed rates that leave each layer the time that it needs to cool."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from hframe_post.studies.speed.drive import Drive
from hframe_post.studies.speed.trial import SpeedSettings

FULL = 0.985  # of its least time that a layer is slowed to
USELESS = 1.001  # times its time, which a layer that was slowed does not reach
SLOWEST = 0.05  # times the feed rate; a layer that takes too little time even then stays so


@dataclass(frozen=True, slots=True)
class LayerTimes:
    """The least time of each layer by its number, s. No layer is slowed below the file's speed."""

    least: dict[int, float]

    @classmethod
    def from_file(cls, layers: dict[int, float], min_layer_time: float) -> LayerTimes:
        """Return the times of a file with these layers, s: no layer needs more than its own."""
        return cls({k: min(seconds, min_layer_time) for k, seconds in layers.items() if k})

    def short(self, settings: SpeedSettings, layers: dict[int, float]) -> bool:
        """Return whether these layers take too little time, and can be slowed."""
        present, slowed = settings.layer_feed, self.slowed(settings, layers).layer_feed
        return any(factor < present.get(layer, 1.0) for layer, factor in slowed.items())

    def slowed(self, settings: SpeedSettings, layers: dict[int, float]) -> SpeedSettings:
        """Return settings with other feed rates in layers not at 98 … 101 % of their least time.

        The exponent makes up for the part of a layer's time that does not depend on the feed rate.
        """
        factors = dict(settings.layer_feed)
        for layer, seconds in layers.items():
            share = seconds / (self.least.get(layer) or math.inf)
            factor = factors.get(layer, 1.0)
            if (0.0 < share < 0.98) or (share > 1.01 and factor < 1.0):
                factors[layer] = min(max(factor * (share / FULL) ** 1.3, SLOWEST), 1.0)
        return replace(settings, layer_feed=factors)

    def planned(self, drive: Drive, settings: SpeedSettings) -> SpeedSettings:
        """Return settings whose plan leaves each layer its time.

        The print is planned six times at most, and only once if few layers change.
        """
        layers = drive.layer_times(settings)
        for _ in range(5):
            slowed = self.slowed(settings, layers)
            if slowed == settings:
                return settings
            before, layers = layers, drive.layer_times_again(slowed, settings, layers)
            factors = {
                layer: SLOWEST
                if factor < settings.layer_feed.get(layer, 1.0)
                and layers.get(layer, 0.0) < USELESS * before.get(layer, 0.0)
                else factor
                for layer, factor in slowed.layer_feed.items()
            }  # the lowest one where a lower one slows nothing more
            settings = replace(slowed, layer_feed=factors)
        return self.slowed(settings, layers)
