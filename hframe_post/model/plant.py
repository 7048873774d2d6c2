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
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from hframe_post.arrays import Array, X, Y
from hframe_post.model.impulse_response import ImpulseResponse, Linear, transfer_function
from hframe_post.model.transfer_function import TransferFunction
from hframe_post.native import plant as native
from hframe_post.native.plant import Couplings, Sections, coupled, filtered, sliding_sums, sum_of

PIECE = 256  # outputs for which the nodes of a response along x are chosen together
STIFF = ImpulseResponse(np.zeros(1), 0)
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


class StreamFilter(Protocol):
    """A linear response applied to a stream, its state carried: equal bits however it is cut."""

    state: Array

    def run(self, u: Array) -> Array:
        """Return the output (n,) at the next samples of the input u (n,)."""

    def advance(self, u: Array) -> None:
        """Take the state that the next samples of the input lead to."""

    def settle(self, u: float) -> None:
        """Take the state that a constant input leads to."""


def stream_filter(G: Linear, late: int) -> StreamFilter:
    """Return the filter of G whose output comes ``late`` samples late, at least G.ahead."""
    if isinstance(G, ImpulseResponse) and G.elsewhere:
        return FilterAlongX(G, late)
    if isinstance(G, ImpulseResponse):
        return FiniteFilter(G, late)
    return LateFilter(G, late) if late else Filter(G)


class Filter:
    """A transfer function applied to a stream, its state carried: equal bits however it is cut."""

    def __init__(self, G: Linear) -> None:
        self.sections = transfer_function(G).sections
        self.state = np.zeros((len(self.sections), 2))

    def run(self, u: Array) -> Array:
        """Return the output (n,) at the next samples of the input u (n,)."""
        return filtered(self.sections, self.state, u)

    def advance(self, u: Array) -> None:
        """Take the state that the next samples of the input lead to."""
        self.run(u)

    def settle(self, u: float) -> None:
        """Take the state that a constant input leads to."""
        for (b0, b1, b2, _, a1, a2), state in zip(self.sections.tolist(), self.state, strict=True):
            y = u * (b0 + b1 + b2) / (1.0 + a1 + a2)
            state[1] = b2 * u - a2 * y
            state[0] = b1 * u - a1 * y + state[1]
            u = y


class LateFilter:
    """A transfer function applied to a stream, its output ``late`` samples late."""

    def __init__(self, G: TransferFunction, late: int) -> None:
        self._filter, self._dc_gain = Filter(G), G.dc_gain
        size = self._filter.state.size
        self.state = np.zeros(size + late)
        self._filter.state, self._waiting = self.state[:size].reshape(-1, 2), self.state[size:]

    def run(self, u: Array) -> Array:
        y = np.concatenate([self._waiting, self._filter.run(u)])
        self._waiting[:] = y[len(u) :]
        return y[: len(u)]

    def advance(self, u: Array) -> None:
        self.run(u)

    def settle(self, u: float) -> None:
        self._filter.settle(u)
        self._waiting[:] = self._dc_gain * u


class FiniteFilter:
    """An impulse response applied to a stream, its output ``late`` samples late.

    state (k,): the latest samples of the input. Acceleration is filtered, which at rest is zero.
    """

    def __init__(self, G: ImpulseResponse, late: int) -> None:
        self._taps = np.ascontiguousarray(G.taps(late)[::-1])  # that of the oldest sample first
        self._rest, self._lag, self._late = G.rest, G.lag, late
        self.state = np.zeros(max(len(self._taps) + 1, late + (1 if G.lag else 0)))

    def run(self, u: Array) -> Array:
        n, memory = len(u), len(self._taps) - 1
        known = np.concatenate([self.state, u])
        y = sliding_sums(self._taps, np.diff(known[len(self.state) - memory - 2 :], n=2))
        before = len(self.state) - self._late
        y += self._rest * known[before : before + n]
        if self._lag:
            y -= self._lag * np.diff(known[before - 1 : before + n])
        self.state[:] = known[n:]
        return y

    def advance(self, u: Array) -> None:
        n = min(len(u), len(self.state))
        self.state[: len(self.state) - n] = self.state[n:].copy()
        self.state[len(self.state) - n :] = u[len(u) - n :]

    def settle(self, u: float) -> None:
        self.state[:] = u


class FilterAlongX(FiniteFilter):
    """A response that changes along x, applied to a stream, its output ``late`` samples late.

    The nodes' responses to the whole past are mixed, each as if it had always been there.
    """

    def __init__(self, G: ImpulseResponse, late: int) -> None:
        self._x = np.array([x for x, _ in G.nodes])
        self._lags = np.array([node.lag for _, node in G.nodes])
        each = [node.taps(late)[::-1] for _, node in G.nodes]
        m = max(map(len, each))
        self._each = [np.pad(taps, (m - len(taps), 0)) for taps in each]
        self._rest, self._late = G.rest, late
        self.state = np.zeros(max(m + 1, late + 1))

    def along(self, u: Array, x: Array) -> Array:
        """Return the output (n,) at the next samples of the input u (n,).

        x (n,): place of the nozzle at the outputs, mm.
        """
        n, memory = len(u), len(self._each[0]) - 1
        known = np.concatenate([self.state, u])
        acceleration = np.diff(known[len(self.state) - memory - 2 :], n=2)
        x = np.clip(x, self._x[0], self._x[-1])
        left = np.clip(np.searchsorted(self._x, x, "right") - 1, 0, len(self._x) - 2)
        share = (x - self._x[left]) / (self._x[left + 1] - self._x[left])
        y = np.zeros(n)
        for a in range(0, n, PIECE):
            piece = slice(a, min(a + PIECE, n))
            nodes, part = left[piece], share[piece]
            for k in range(int(nodes.min()), int(nodes.max()) + 2):
                weight = np.where(nodes == k, 1.0 - part, np.where(nodes == k - 1, part, 0.0))
                around = acceleration[a : piece.stop + memory]
                y[piece] += weight * sliding_sums(self._each[k], around)
        before = len(self.state) - self._late
        y += self._rest * known[before : before + n]
        lag = (1.0 - share) * self._lags[left] + share * self._lags[left + 1]
        y -= lag * np.diff(known[before - 1 : before + n])
        self.state[:] = known[n:]
        return y


def _output(f: StreamFilter, u: Array, x: Array) -> Array:
    """Return the output (n,) of a filter, which may change along x (n,), mm."""
    return f.along(u, x) if isinstance(f, FilterAlongX) else f.run(u)


class Filters:
    """Filters side by side, each ``late`` samples late; ``along_x``: whether one changes along x.

    couplings: the last filters'. If all are transfer functions without delay they are ``fused``, in
    one block of memory.
    """

    def __init__(self, direct: Sequence[Linear], couplings: Sequence[Coupling], late: int) -> None:
        functions = (*direct, *(coupling.G for coupling in couplings))
        self.each = [stream_filter(G, late) for G in functions]
        self.late, self.along_x = late, any(map(varies, functions))
        axes = [(c.answer, c.command, -1 if c.along is None else c.along) for c in couplings]
        centres = np.array([coupling.centre for coupling in couplings])
        self.couplings = Couplings(np.array(axes, np.int64).reshape(-1, 3), centres)
        self.fused = _fused(self.each)

    @classmethod
    def of_plant(cls, plant: Plant, late: int) -> Filters:
        return cls((plant.Gxx, plant.Gyy), plant.couplings, late)

    @property
    def commands(self) -> list[int]:
        """Return the axis of the command of each coupling."""
        commands: list[int] = self.couplings.axes[:, 1].tolist()
        return commands


def _fused(filters: Sequence[StreamFilter]) -> Sections | None:
    """Return the sections of all filters, whose states become parts of it; None if not all have."""
    alone = [f for f in filters if isinstance(f, Filter)]
    if len(alone) < len(filters):
        return None
    table = np.concatenate([f.sections for f in alone])
    counts = np.array([len(f.sections) for f in alone])
    fused = Sections(table, np.zeros((len(table), 2)), counts)
    for f, (_, state) in zip(alone, fused.each(), strict=True):
        f.state = state
    return fused


class Coupled:
    """What couplings add to the nozzle in one axis, under commands that come in pieces.

    late: samples by which the result comes later than the commands.
    """

    def __init__(self, couplings: Sequence[Coupling], origin: Array) -> None:
        self.late = max(coupling.G.ahead for coupling in couplings)
        self._filters, self._origin = Filters((), couplings, self.late), origin

    def run(self, path: Array, x_dm: Array, y_dm: Array) -> Array:
        """Return the sum (n,) at samples of the path (n, 2), which lag behind the commands (n,).

        All are relative to the origin. The lever arms are those of the path.
        """
        filters, couplings, commands = self._filters, self._filters.couplings, (x_dm, y_dm)
        if filters.fused is not None:
            return coupled(filters.fused, couplings, self._origin, path, commands)
        place = path + self._origin
        outputs = [
            _output(G, commands[axis], place[:, X])
            for G, axis in zip(filters.each, filters.commands, strict=True)
        ]
        return sum_of(outputs, couplings, place)


class Response:
    """The nozzle's motion under a command that comes in pieces, from rest at ``origin`` (2,).

    late: samples by which the motion comes later than the command, at least and by default the
    plant's ``ahead``. away: mm of x from where places are counted, for responses that change along
    x and a command that is counted from elsewhere.
    """

    def __init__(
        self, plant: Plant, origin: Array, late: int | None = None, away: float = 0.0
    ) -> None:
        self.late = plant.ahead if late is None else late
        self._filters = Filters.of_plant(plant, self.late)
        self._origin = origin
        # where responses change along x, the command tells x: the nozzle is within half a mm of it
        self._x = FiniteFilter(STIFF, self.late) if self._filters.along_x else None
        self._from_x = float(origin[X]) + away

    def settle(self, command: Array) -> None:
        """Come to rest under a command (2,)."""
        u = (command - self._origin).tolist()
        for f, axis in self._commanded():
            f.settle(u[axis])

    def advance(self, command: Array) -> None:
        """Go on to the state after the next samples of the command (n, 2)."""
        if self._filters.fused is not None:  # all at once is faster than one by one
            self.run(command)
            return
        u = (command - self._origin).T
        for f, axis in self._commanded():
            f.advance(u[axis])

    def _commanded(self) -> Iterator[tuple[StreamFilter, int]]:
        """Yield each filter with the axis of its command."""
        yield from zip(self._filters.each, (X, Y, *self._filters.commands), strict=True)
        if self._x is not None:
            yield self._x, X

    def run(self, command: Array, out: Array | None = None) -> Array:
        """Return the nozzle's x, y (n, 2) at samples that lag behind those of command (n, 2).

        It is in ``out``, if given.
        """
        return self._motion(command, np.empty((len(command), 2)) if out is None else out)

    def motion(self, command: Array) -> tuple[Array, Array]:
        """Return the nozzle's x, y (n, 2), and what each coupling's G gives, (n, couplings)."""
        both = self._motion(command, np.empty((len(command), len(self._filters.each))))
        return both[:, :2], both[:, 2:]

    def imagined(self, command: Array) -> tuple[Array, Array]:
        """Return what ``motion`` would, and keep the state."""
        filters = [f for f, _ in self._commanded()]
        states = [f.state.copy() for f in filters]
        motion = self.motion(command)
        for f, state in zip(filters, states, strict=True):
            f.state[:] = state
        return motion

    def _motion(self, command: Array, motion: Array) -> Array:
        filters, couplings = self._filters, self._filters.couplings
        if filters.fused is not None:
            return native.response(filters.fused, couplings, self._origin, command, motion)
        u = np.subtract(command.T, self._origin[:, None], order="C")
        x = u[X] if self._x is None else self._x.run(u[X]) + self._from_x
        axes = X, Y, *filters.commands
        outputs = [_output(f, u[axis], x) for f, axis in zip(filters.each, axes, strict=True)]
        return native.nozzle(outputs, couplings, self._origin, motion)


def nozzle(plant: Plant, origin: Array, command: Array) -> Array:
    """Return the nozzle's x, y (n, 2) under a whole command (n, 2).

    The plant rests at ``origin`` (2,) before it, and the command rests after it.
    """
    return motion(plant, origin, command)[0]


def motion(plant: Plant, origin: Array, command: Array) -> tuple[Array, Array]:
    """Return what ``nozzle`` does, and what each coupling's G gives, (n, couplings)."""
    response = Response(plant, origin)
    following = np.pad(command, ((0, response.late), (0, 0)), mode="edge")
    place, outputs = response.motion(following)
    return place[response.late :], outputs[response.late :]
