"""The linear plant of a printer.

The printer of the paper moves as (eq. 1, 2 and Fig. 2b)

    x = Gxx·x_d        θ = Gxθ·x_d        y = Gyy·y_d + (x − x_c)·θ

A bed that moves in y gets heavier by what is printed on it, and Gyy follows (``loaded``).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from hframe_post.arrays import Array, X
from hframe_post.model.impulse_response import FiniteFilter, ImpulseResponse
from hframe_post.model.transfer_function import TransferFunction

HEAVIER = 0.005  # step of the logarithm of a bed's mass; frequencies follow within 0.13 %


@dataclass(frozen=True)
class Racking:
    """What a command in x adds to the nozzle in y: the lever arm times θ = G·x_d.

    x_c: mm, where the lever arm is 0.
    """

    G: ImpulseResponse
    x_c: float

    def lever(self, place: Array) -> Array:
        """Return the lever arm (n,) at places (n, 2) on the bed, mm, without racking."""
        return np.asarray(place[:, X] - self.x_c)

    def theta(self, x: Array) -> Array:
        """Return θ (n,), rad, under a whole command x (n,), mm, at rest before and after it."""
        late = self.G.ahead
        return FiniteFilter(self.G, late).run(np.pad(x - x[0], (0, late), mode="edge"))[late:]


@dataclass(frozen=True)
class Bed:
    """A bed that moves in y. mass: kg that Gyy was measured with; filament: kg in a mm of it."""

    mass: float
    filament: float


@dataclass(frozen=True)
class Plant:
    """The three responses of Fig. 2(b); ``Gxtheta`` is None if the gantry does not rack.

    A transfer function in place of one becomes a response; ArgumentError if it cannot.
    Gxtheta gives θ in rad per mm of x_d; x_c (mm) is the x coordinate at which racking
    does not move the nozzle. bed: None if it does not move, or nothing is
    known of it.
    """

    Gxx: ImpulseResponse
    Gyy: ImpulseResponse
    Gxtheta: ImpulseResponse | None
    x_c: float
    bed: Bed | None = None

    def __post_init__(self) -> None:
        for name, rest in (("Gxx", 1.0), ("Gyy", 1.0), ("Gxtheta", 0.0)):
            G = getattr(self, name)
            if isinstance(G, TransferFunction):
                object.__setattr__(self, name, ImpulseResponse.from_transfer_function(G, rest))

    @property
    def racking(self) -> Racking | None:
        """Return what x does to y, if anything."""
        return None if self.Gxtheta is None else Racking(self.Gxtheta, self.x_c)

    @property
    def responses(self) -> tuple[ImpulseResponse, ...]:
        """Return those of x, of y and, if the gantry racks, of θ."""
        theta = () if self.Gxtheta is None else (self.Gxtheta,)
        return self.Gxx, self.Gyy, *theta

    @property
    def ahead(self) -> int:
        """Return how many samples of a command after a sample the nozzle's place depends on."""
        return max(G.ahead for G in self.responses)

    def decoupled(self) -> Plant:
        """Return the plant without racking."""
        return replace(self, Gxtheta=None)

    def load(self, filament: float) -> int:
        """Return in how many steps of HEAVIER this filament (mm) makes the bed heavier."""
        if self.bed is None:
            return 0
        added = max(filament, 0.0) * self.bed.filament / self.bed.mass
        return round(math.log1p(added) / HEAVIER)

    def loaded(self, load: int) -> Plant:
        """Return the plant under a load, which then stays."""
        if not load:
            return replace(self, bed=None)
        return replace(self, Gyy=self.Gyy.heavier(math.exp(HEAVIER * load)), bed=None)
