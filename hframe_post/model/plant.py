"""The linear plant of a printer, and the nozzle's response to a command.

The printer of the paper moves as (eq. 1, 2 and Fig. 2b)

    x = Gxx·x_d        θ = Gxθ·x_d        y = Gyy·y_d + (x − x_c)·θ

A bed that moves in y gets heavier by what is printed on it, and Gyy follows (``loaded``).

θ is one coupling: what a command adds to the nozzle's place, beyond its own axis' part. A plant
may have others, each the same all over the bed or with a lever arm as θ has.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib.machinery import PathFinder
from importlib.util import module_from_spec
from pathlib import Path
from typing import cast

import numpy as np

from hframe_post.arrays import Array, Integers, X, Y
from hframe_post.model.transfer_function import TransferFunction
from hframe_post.native import kernel

HEAVIER = 0.005  # step of the logarithm of a bed's mass; frequencies follow within 0.13 %


@dataclass(frozen=True)
class Coupling:
    """What a command in one axis adds to the nozzle in one axis: lever·G·command.

    answer, command: the axes. along: axis of the lever arm, which is the nozzle's distance from
    ``centre`` (mm) without any coupling; None: lever is 1, and G the same all over the bed.
    """

    answer: int
    command: int
    G: TransferFunction
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
    """The three transfer functions of Fig. 2(b); ``Gxtheta`` is None if the gantry does not rack.

    Gxtheta gives θ in rad per mm of x_d; x_c (mm) is the x coordinate at which racking
    does not move the nozzle. cross: couplings other than racking. bed: None if it does not move,
    or nothing is known of it.
    """

    Gxx: TransferFunction
    Gyy: TransferFunction
    Gxtheta: TransferFunction | None
    x_c: float
    cross: tuple[Coupling, ...] = ()
    bed: Bed | None = None

    @property
    def couplings(self) -> tuple[Coupling, ...]:
        """Return all couplings, racking first."""
        if self.Gxtheta is None:
            return self.cross
        return Coupling(Y, X, self.Gxtheta, X, self.x_c), *self.cross

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


def heavier(G: TransferFunction, factor: float) -> TransferFunction:
    """Return G with ``factor`` times the mass behind its modes.

    Of s²/ω² + 2ζs/ω + 1, for each pair of poles or zeros, only the first term grows: ω and ζ fall
    by √factor, and G at rest and the lag at low speed stay. So do real roots, and pairs above a
    quarter of the sampling rate: lags and delays.
    """

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


class Filter:
    """A transfer function applied to a stream, its state carried: equal bits however it is cut."""

    def __init__(self, G: TransferFunction) -> None:
        self.sections = G.sections
        self.state = np.zeros((len(G.sections), 2))

    def run(self, u: Array) -> Array:
        """Return the output (n,) at the next samples of the input u (n,)."""
        if (compiled := kernel("filtered")) is not None:
            u, y = np.ascontiguousarray(u), np.empty(len(u))
            compiled(self.sections, len(self.sections), self.state, u, len(u), y)
            return y
        signals = np.array(u, ndmin=2)
        _cascade()(self.sections, signals, self.state[None])
        return np.asarray(signals[0])

    def settle(self, u: float) -> None:
        """Take the state that a constant input leads to."""
        for (b0, b1, b2, _, a1, a2), state in zip(self.sections.tolist(), self.state, strict=True):
            y = u * (b0 + b1 + b2) / (1.0 + a1 + a2)
            state[1] = b2 * u - a2 * y
            state[0] = b1 * u - a1 * y + state[1]
            u = y


@cache
def _cascade() -> Callable[[Array, Array, Array], None]:
    """Return scipy's filter of sections (k, 6), which replaces signals (1, n) and states (1, k, 2).

    It is loaded alone, because all of scipy.signal takes 0.7 s and 70 MB; a scipy that has it
    elsewhere is asked in the usual way.
    """
    import scipy

    place = str(Path(scipy.__file__).parent / "signal")
    spec = PathFinder.find_spec("_sosfilt", [place])
    if spec is None or spec.loader is None:
        return _by_scipy_signal
    alone = module_from_spec(spec)
    spec.loader.exec_module(alone)
    return cast(Callable[[Array, Array, Array], None], alone._sosfilt)


def _by_scipy_signal(sections: Array, signals: Array, states: Array) -> None:
    from scipy.signal import sosfilt

    if signals.size:  # scipy takes no empty array
        signals[0], states[0] = sosfilt(sections, signals[0], zi=states[0])


class Filters:
    """Filters side by side, in one block of memory for the compiled loops.

    sections (k, 6), state (k, 2): of all of them, in turn; counts: how many each has. axes
    (couplings, 3): of the answer, of the command, and of the lever arm or -1; centres (couplings,).
    """

    def __init__(self, direct: Sequence[TransferFunction], couplings: Sequence[Coupling]) -> None:
        self.each = [Filter(G) for G in (*direct, *(coupling.G for coupling in couplings))]
        self.couplings = couplings
        self.sections = np.concatenate([f.sections for f in self.each])
        self.counts = np.array([len(f.sections) for f in self.each])
        self.state = np.zeros((len(self.sections), 2))
        parts = np.split(self.state, np.cumsum(self.counts)[:-1])
        for f, part in zip(self.each, parts, strict=True):
            f.state = part
        axes = [(c.answer, c.command, -1 if c.along is None else c.along) for c in couplings]
        self.axes = np.array(axes, np.int64).reshape(-1, 3)
        self.centres = np.array([coupling.centre for coupling in couplings])

    @classmethod
    def of_plant(cls, plant: Plant) -> Filters:
        return cls((plant.Gxx, plant.Gyy), plant.couplings)

    def arguments(self) -> tuple[Array | Integers | int, ...]:
        """Return the first arguments of a compiled loop."""
        return (
            self.sections, len(self.sections), self.state, self.counts, len(self.each),
            self.axes, self.centres, len(self.axes),
        )  # fmt: skip


class Coupled:
    """What couplings add to the nozzle in one axis, under commands that come in pieces."""

    def __init__(self, couplings: Sequence[Coupling], origin: Array) -> None:
        self._filters, self._origin = Filters((), couplings), origin

    def run(self, path: Array, x_dm: Array, y_dm: Array) -> Array:
        """Return the sum (n,) at the next samples of the path (n, 2) and of commands (n,).

        All are relative to the origin. The lever arms are those of the path.
        """
        filters, added = self._filters, np.zeros(len(path))
        if (compiled := kernel("coupled")) is not None:
            path, x_dm, y_dm = (np.ascontiguousarray(each) for each in (path, x_dm, y_dm))
            compiled(*filters.arguments(), self._origin, path, x_dm, y_dm, len(path), added)
            return added
        place, commands = path + self._origin, (x_dm, y_dm)
        for coupling, G in zip(filters.couplings, filters.each, strict=True):
            added += coupling.lever(place) * G.run(commands[coupling.command])
        return added


class Response:
    """The nozzle's motion under a command that comes in pieces, from rest at ``origin`` (2,)."""

    def __init__(self, plant: Plant, origin: Array) -> None:
        self._filters = Filters.of_plant(plant)
        self._origin, self.state = origin, self._filters.state

    def settle(self, command: Array) -> None:
        """Come to rest under a command (2,)."""
        u = (command - self._origin).tolist()
        axes = X, Y, *(coupling.command for coupling in self._filters.couplings)
        for f, axis in zip(self._filters.each, axes, strict=True):
            f.settle(u[axis])

    def run(self, command: Array) -> Array:
        """Return the nozzle's x, y (n, 2) under the next samples of the command (n, 2)."""
        return self._motion(command, 0)

    def motion(self, command: Array) -> tuple[Array, Array]:
        """Return the nozzle's x, y (n, 2), and what each coupling's G gives, (n, couplings)."""
        both = self._motion(command, len(self._filters.couplings))
        return both[:, :2], both[:, 2:]

    def _motion(self, command: Array, shown: int) -> Array:
        filters, n = self._filters, len(command)
        if (compiled := kernel("response")) is not None:
            command, motion = np.ascontiguousarray(command), np.empty((n, 2 + shown))
            compiled(*filters.arguments(), self._origin, command, n, motion, 2 + shown)
            return motion
        u = command - self._origin
        Gxx, Gyy, *others = filters.each
        place = np.column_stack([Gxx.run(u[:, X]), Gyy.run(u[:, Y])]) + self._origin
        nozzle, outputs = place.copy(), []
        for coupling, G in zip(filters.couplings, others, strict=True):
            outputs.append(G.run(u[:, coupling.command]))
            nozzle[:, coupling.answer] += coupling.lever(place) * outputs[-1]
        return np.column_stack([nozzle, *outputs[:shown]])
