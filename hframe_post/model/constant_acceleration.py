"""Motion at constant acceleration, as firmware makes it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from hframe_post.arrays import Array


@dataclass(frozen=True, slots=True)
class Trapezoid:
    """A motion: length (mm), limits of speed and acceleration; v_s, v_e: speeds at its ends.

    peak: its greatest speed; seconds: how long it takes.
    """

    length: float
    cruise: float
    acceleration: float
    v_s: float = 0.0
    v_e: float = 0.0
    peak: float = field(init=False)
    seconds: float = field(init=False)

    def __post_init__(self) -> None:
        v_s, v_e, a = self.v_s, self.v_e, self.acceleration
        reached = math.sqrt(self.length * a + (v_s * v_s + v_e * v_e) / 2.0)
        peak = reached if reached < self.cruise else self.cruise
        ramped = ((peak - v_s) ** 2 + (peak - v_e) ** 2) / (2.0 * a)
        object.__setattr__(self, "peak", peak)
        object.__setattr__(self, "seconds", (self.length + ramped) / peak)

    @property
    def ramps(self) -> tuple[float, float]:
        """Return how long it accelerates and brakes, s."""
        peak = self.peak
        return (peak - self.v_s) / self.acceleration, (peak - self.v_e) / self.acceleration

    @property
    def row(self) -> Array:
        """Return length, v_s, acceleration, peak, both ramps' and all of the seconds, (7,)."""
        way = self.length, self.v_s, self.acceleration, self.peak, *self.ramps, self.seconds
        return np.array(way)

    def slowed_to(self, seconds: float) -> Trapezoid:
        """Return the same motion at the lower speed at which it takes so long, or itself if longer.

        Solves length = v·T − [(v − v_s)² + (v − v_e)²]/2a for v no lower than v_s and v_e.
        """
        if seconds <= self.seconds:
            return self
        S = self.acceleration * seconds + self.v_s + self.v_e
        c = (self.v_s * self.v_s + self.v_e * self.v_e) / 2.0 + self.acceleration * self.length
        v = (S - math.sqrt(max(S * S - 4.0 * c, 0.0))) / 2.0
        cruise = min(max(v, self.v_s, self.v_e), self.cruise)
        return Trapezoid(self.length, cruise, self.acceleration, self.v_s, self.v_e)

    def distance(self, t: Array) -> Array:
        """Return the distance done (n,), mm, at times t (n,), s, after its beginning."""
        up, down = self.ramps
        t = np.clip(t, 0.0, self.seconds)
        begun, ending = np.minimum(t, up), np.maximum(t - (self.seconds - down), 0.0)
        lost = self.acceleration * ending * ending / 2.0
        gained = begun * (self.v_s + self.acceleration * begun / 2.0)
        return np.asarray(gained + self.peak * (t - begun) - lost)
