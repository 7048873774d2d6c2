"""The linear plant of a printer.

The printer of the paper moves as (eq. 1, 2 and Fig. 2b)

    x = Gxx·x_d        θ = Gxθ·x_d        y = Gyy·y_d + (x − x_c)·θ

A bed that moves in y gets heavier by what is printed on it, and Gyy follows (``loaded``).

θ is one coupling: what a command adds to the nozzle's place, beyond its own axis' part. A plant
may have others, each the same all over the bed or with a lever arm as θ has.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from hframe_post.arrays import Array, X, Y
from hframe_post.model.impulse_response import ImpulseResponse
from hframe_post.model.transfer_function import TransferFunction

HEAVIER = 0.005  # step of the logarithm of a bed's mass; frequencies follow within 0.13 %


@dataclass(frozen=True)
class Coupling:
    """What a command in one axis adds to the nozzle in one axis: lever·G·command.

    answer, command: the axes. along: axis of the lever arm, which is the nozzle's distance from
    ``centre`` (mm) without any coupling; None: lever is 1, and G the same all over the bed.
    """

    answer: int
    command: int
    G: ImpulseResponse
    along: int | None = None
    centre: float = 0.0

    def lever(self, place: Array) -> Array | float:
        """Return the lever arm (n,) at places (n, 2) on the bed, mm."""
        return 1.0 if self.along is None else np.asarray(place[:, self.along] - self.centre)


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
    does not move the nozzle. cross: couplings other than racking. bed: None if it does not move,
    or nothing is known of it.
    """

    Gxx: ImpulseResponse
    Gyy: ImpulseResponse
    Gxtheta: ImpulseResponse | None
    x_c: float
    cross: tuple[Coupling, ...] = ()
    bed: Bed | None = None

    def __post_init__(self) -> None:
        for name, rest in (("Gxx", 1.0), ("Gyy", 1.0), ("Gxtheta", 0.0)):
            G = getattr(self, name)
            if isinstance(G, TransferFunction):
                object.__setattr__(self, name, ImpulseResponse.from_transfer_function(G, rest))

    @property
    def couplings(self) -> tuple[Coupling, ...]:
        """Return all couplings, racking first."""
        if self.Gxtheta is None:
            return self.cross
        return Coupling(Y, X, self.Gxtheta, X, self.x_c), *self.cross

    @property
    def responses(self) -> tuple[ImpulseResponse, ...]:
        """Return those of x, of y and of all couplings."""
        return self.Gxx, self.Gyy, *(coupling.G for coupling in self.couplings)

    @property
    def ahead(self) -> int:
        """Return how many samples of a command after a sample the nozzle's place depends on."""
        return max(G.ahead for G in self.responses)

    @property
    def memory(self) -> int:
        """Return how many samples of a command before a sample the nozzle's place depends on."""
        return max(G.memory for G in self.responses)

    def decoupled(self) -> Plant:
        """Return the plant without couplings."""
        return replace(self, Gxtheta=None, cross=())

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
