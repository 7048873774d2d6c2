"""The linear plant of a printer.

The printer of the paper moves as (eq. 1, 2 and Fig. 2b)

    x = Gxx·x_d        θ = Gxθ·x_d        y = Gyy·y_d + (x − x_c)·θ

A bed that moves in y gets heavier by what is printed on it, and Gyy follows (``loaded``).

θ is one coupling: what a command adds to the nozzle's place, beyond its own axis' part. A plant
may have others, each the same all over the bed or with a lever arm as θ has.
"""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass, replace

import numpy as np

from hframe_post.arrays import Array, X, Y
from hframe_post.model.impulse_response import ImpulseResponse, Linear
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
    G: Linear
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

    Gxtheta gives θ in rad per mm of x_d; x_c (mm) is the x coordinate at which racking
    does not move the nozzle. cross: couplings other than racking. bed: None if it does not move,
    or nothing is known of it.
    """

    Gxx: Linear
    Gyy: Linear
    Gxtheta: Linear | None
    x_c: float
    cross: tuple[Coupling, ...] = ()
    bed: Bed | None = None

    @property
    def couplings(self) -> tuple[Coupling, ...]:
        """Return all couplings, racking first."""
        if self.Gxtheta is None:
            return self.cross
        return Coupling(Y, X, self.Gxtheta, X, self.x_c), *self.cross

    @property
    def ahead(self) -> int:
        """Return how many samples of a command after a sample the nozzle's place depends on."""
        each = self.Gxx, self.Gyy, *(coupling.G for coupling in self.couplings)
        return max(G.ahead for G in each)

    @property
    def memory(self) -> int:
        """Return how many samples of a command before a sample the nozzle's place depends on."""
        each = self.Gxx, self.Gyy, *(coupling.G for coupling in self.couplings)
        return max(G.memory for G in each)

    @property
    def along_x(self) -> bool:
        """Return whether a response changes along x."""
        return len(self.places) > 1

    @property
    def places(self) -> tuple[float, ...]:
        """Return x (mm) of all nodes between which responses change; one, if none changes."""
        each = self.Gxx, self.Gyy, *(coupling.G for coupling in self.couplings)
        moving = [G for G in each if isinstance(G, ImpulseResponse) and G.elsewhere]
        return tuple(sorted({x for G in moving for x, _ in G.nodes})) or (0.0,)

    def at(self, x: float) -> Plant:
        """Return the plant as it is near this x (mm), all along x."""
        Gxtheta = None if self.Gxtheta is None else there(self.Gxtheta, x)
        cross = tuple(replace(each, G=there(each.G, x)) for each in self.cross)
        Gxx, Gyy = there(self.Gxx, x), there(self.Gyy, x)
        return replace(self, Gxx=Gxx, Gyy=Gyy, Gxtheta=Gxtheta, cross=cross)

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
        return replace(self, Gyy=heavier(self.Gyy, math.exp(HEAVIER * load)), bed=None)


def varies(G: Linear) -> bool:
    """Return whether a response changes along x."""
    return isinstance(G, ImpulseResponse) and bool(G.elsewhere)


def there(G: Linear, x: float) -> Linear:
    """Return the response as it is near this x (mm), all along x."""
    return G.at(x) if isinstance(G, ImpulseResponse) else G


def heavier(G: Linear, factor: float) -> Linear:
    """Return G with ``factor`` times the mass behind its modes.

    A measured response takes √factor times as long; its lag stays.

    Of a transfer function's s²/ω² + 2ζs/ω + 1, for each pair of poles or zeros, only the first
    term grows: ω and ζ fall by √factor, and G at rest and the lag at low speed stay. So do real
    roots, and pairs above a quarter of the sampling rate: lags and delays.
    """

    if isinstance(G, ImpulseResponse):
        longer = math.sqrt(factor)
        return G.everywhere(lambda one: replace(one.stretched(longer), lag=one.lag))

    def moved(root: complex) -> complex:
        if root.imag == 0.0 or root.real <= 0.0:
            return root
        s = cmath.log(root)
        decay = s.real / factor
        ringing = math.sqrt(abs(s) ** 2 / factor - decay * decay)
        return cmath.exp(complex(decay, math.copysign(ringing, s.imag)))

    zeros, poles = (np.array([*map(moved, roots.tolist())]) for roots in (G.zeros, G.poles))
    new = TransferFunction(zeros, poles, G.gain)
    return replace(new, gain=G.gain * G.dc_gain / new.dc_gain)
