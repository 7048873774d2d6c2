"""The linear plant of a printer, and the nozzle's motion under a command.

The printer of the paper moves as (eq. 1, 2 and Fig. 2b)

    x = Gxx·x_d        θ = Gxθ·x_d        y = Gyy·y_d + (x − x_c)·θ

A bed that moves in y gets heavier by what is printed on it, and Gyy follows (``loaded``).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from hframe_post.arrays import Array, X, Y, moved
from hframe_post.errors import ArgumentError
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

    def perturbed(self, factors: Array) -> Plant:
        """Return the plant with factors (3, 3) on frequency, damping and gain of Gxx, Gyy and Gxθ.

        Each response takes more or less time, as it does when a belt gets tighter or a carriage
        heavier, and decays faster or slower. A nozzle at rest stays where its steps put it; only
        the gain of racking changes.
        """
        (fx, dx, _), (fy, dy, _), theta = factors.tolist()
        Gxx, Gyy = _perturbed(self.Gxx, fx, dx), _perturbed(self.Gyy, fy, dy)
        Gxtheta = self.Gxtheta and _perturbed(self.Gxtheta, *theta)
        return replace(self, Gxx=Gxx, Gyy=Gyy, Gxtheta=Gxtheta)

    def drawn(self, share: float, count: int, seed: int) -> list[Plant]:
        """Return ``count`` random plants, parameters off by up to a share (0.05: ±5 %), uniformly.

        Equal seeds give the same printers at every share, only farther off. Raises ArgumentError
        for a share that is not from 0 to below 1.
        """
        if not 0.0 <= share < 1.0:
            raise ArgumentError(f"a model error is a share from 0 to below 1, not {share:g}")
        rng = np.random.default_rng(seed)
        units = rng.uniform(-1.0, 1.0, (count, 3, 3))  # draw, transfer function, parameter
        return [self.perturbed(1.0 + share * unit) for unit in units]


def _perturbed(
    G: ImpulseResponse, frequency: float, damping: float, gain: float = 1.0
) -> ImpulseResponse:
    """Return a response with other frequencies and decays of its modes, each times a factor.

    The lag is a damper's, too.
    """
    changed = G.stretched(1.0 / frequency).damped(damping)
    return replace(changed, deviation=gain * changed.deviation, lag=gain * (damping * changed.lag))


# ---------------------------------------------------------------------- the nozzle under a command


class Response:
    """The nozzle's motion under a command that comes in pieces, from rest at ``origin`` (2,).

    late: samples by which the motion comes later than the command.
    """

    def __init__(self, plant: Plant, origin: Array) -> None:
        self.late, self._racking, self._origin = plant.ahead, plant.racking, origin
        self._filters = [FiniteFilter(G, self.late) for G in plant.responses]

    def run(self, command: Array) -> Array:
        """Return the nozzle's x, y (n, 2) at samples that lag behind those of command (n, 2)."""
        return self.motion(command)[0]

    def motion(self, command: Array) -> tuple[Array, Array]:
        """Return what ``run`` does, and θ (n,) there, rad."""
        u = np.subtract(command.T, self._origin[:, None], order="C")
        axes = (X, Y, X)[: len(self._filters)]
        x, y, *theta = (f.run(u[axis]) for f, axis in zip(self._filters, axes, strict=True))
        place = moved((x, y), self._origin)
        if not self._racking:
            return place, np.zeros(len(place))
        place[:, Y] += self._racking.lever(place) * theta[0]
        return place, theta[0]


def nozzle(plant: Plant, origin: Array, command: Array) -> Array:
    """Return the nozzle's x, y (n, 2) under a whole command (n, 2).

    The plant rests at ``origin`` (2,) before it, and the command rests after it.
    """
    response = Response(plant, origin)
    following = np.pad(command, ((0, response.late), (0, 0)), mode="edge")
    return response.run(following)[response.late :]
