"""Compensation strategies: none, filtered B-splines, and filtered B-splines with couplings.

To add a strategy, write a class with ``feed`` and ``finish`` (see ``StrategyState``) and add a row
to ``STRATEGIES``. Profiles, the command line, reports and figures take their choices from there.

==========  ===============================================================  ==========
symbol      meaning                                                          source
==========  ===============================================================  ==========
``x_d``     desired path                                                     eq. 5
``x_dm``    command whose filtered splines follow x_d                        eq. 12
``θ``       Gxθ x_dm, known exactly once x_dm is final                       eq. 13
``y_dm``    command whose filtered splines follow y_d − (x_d − x_c)·θ        eq. 19
==========  ===============================================================  ==========

Racking is one coupling; others are subtracted likewise.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass
from functools import partial
from typing import Protocol

import numpy as np

from hframe_post.arrays import Array, X, Y, moved
from hframe_post.errors import ArgumentError, HframeError
from hframe_post.model.impulse_response import ImpulseResponse
from hframe_post.model.lpfbs import Lpfbs, SolversAlongX, Window
from hframe_post.model.nozzle import Coupled
from hframe_post.model.plant import HEAVIER, Coupling, Plant
from hframe_post.model.rounds import order, rounds_needed


class Compensator:
    """A plant with the certified solvers of its axes. Raises ArgumentError as ``Lpfbs`` does.

    windows: those of x and y, of the same sizes.
    """

    def __init__(self, plant: Plant, windows: tuple[Window, Window]) -> None:
        self.plant = plant
        self.x, self.y = _solver(plant.Gxx, windows[X]), _solver(plant.Gyy, windows[Y])
        self.rounds = rounds_needed(plant, windows)
        self._latest: tuple[int, Compensator] = 0, self

    def at(self, filament: float) -> Compensator:
        """Return the compensator for the bed with this filament (mm) on it; the latest is kept.

        Raises HframeError if a window does not suit a bed as heavy.
        """
        load = self.plant.load(filament)
        if self._latest[0] != load:
            self._latest = load, self._loaded(load) if load else self
        return self._latest[1]

    def _loaded(self, load: int) -> Compensator:
        loaded = copy(self)
        try:
            loaded.plant = self.plant.loaded(load)
            loaded.y = _solver(loaded.plant.Gyy, self.y.window)
            loaded.rounds = rounds_needed(loaded.plant, (self.x.window, self.y.window))
        except ArgumentError as error:
            percent = 100.0 * math.expm1(HEAVIER * load)
            raise HframeError(f"with the bed {percent:.0f} % heavier, {error}") from None
        loaded._latest = 0, loaded
        return loaded


class StrategyState(Protocol):
    """One strategy at work on one stretch, which begins and ends at rest."""

    def feed(self, xy: Array) -> Array:
        """Take path samples (n, 2) in mm; return the command samples that are final, (k, 2).

        The samples returned so far are never more than the samples taken.
        """

    def finish(self) -> Array:
        """Return the remaining command samples, (k, 2), at the end of the stretch."""


@dataclass(frozen=True, slots=True)
class Strategy:
    """How a path becomes a command. label: shown to users; colour: used in every figure.

    begin: returns the state for a stretch that starts from rest at an origin (2,), mm.
    assumed: returns the plant that the commands are made for, or None where they are the path.
    """

    name: str
    label: str
    colour: str
    begin: Callable[[Compensator, Array], StrategyState]
    assumed: Callable[[Plant], Plant | None] = lambda plant: plant


class _Uncompensated:
    def __init__(self, compensator: Compensator, origin: Array) -> None:
        pass

    def feed(self, xy: Array) -> Array:
        return xy

    def finish(self) -> Array:
        return np.zeros((0, 2))


class FilteredSplines:
    """Solves the axes in turn, each for its target less what couplings add, if asked."""

    def __init__(self, coupled: bool, compensator: Compensator, origin: Array) -> None:
        couplings = compensator.plant.couplings if coupled else ()
        self._origin, solvers = origin, (compensator.x, compensator.y)
        self._path = np.zeros((0, 2))  # from the origin, where the command is not final
        moving = tuple(isinstance(each, SolversAlongX) for each in solvers)
        self._stages = [
            _Stage(axis, solvers[axis], [c for c in couplings if c.answer == axis], origin)
            for axis in order(couplings, compensator.rounds, (moving[X], moving[Y]))
        ]

    def feed(self, xy: Array) -> Array:
        self._path = np.concatenate([self._path, moved(xy.T, -self._origin)])
        return self._command(last=False)

    def finish(self) -> Array:
        return self._command(last=True)

    def _command(self, last: bool) -> Array:
        """Return what is final of the command. last: the path ends here."""
        latest = list(self._path.T)  # commands of x and y; the path, before they are solved
        for stage in self._stages:
            latest[stage.axis] = stage.solve(self._path, latest, last)
        n = min(map(len, latest))
        command = moved([axis[:n] for axis in latest], self._origin)
        self._path = self._path[n:].copy()
        for stage in self._stages:
            stage.forget(n)
        return command


class _Stage:
    """Solves one axis, from commands that the couplings on it depend on.

    What the axis' own earlier command does counts as a coupling, if its response changes along x.
    """

    def __init__(
        self, axis: int, solvers: Lpfbs | SolversAlongX, couplings: Sequence[Coupling],
        origin: Array,
    ) -> None:  # fmt: skip
        self.axis, self._origin = axis, origin
        self._solver: _Axis | _AlongX
        if isinstance(solvers, SolversAlongX):
            self._solver = _AlongX(solvers)
            couplings = [*couplings, Coupling(axis, axis, solvers.G)]
        else:
            self._solver = _Axis(solvers)
        self._coupled = Coupled(couplings, origin) if couplings else None
        self._taken = 0  # samples of which the solver knows the target
        self._fed = 0  # samples of which the couplings know the commands
        self._solved = np.zeros(0)

    def solve(self, path: Array, commands: Sequence[Array], last: bool) -> Array:
        """Return what is final of the axis' command, for the path (n, 2) from the origin.

        commands: the latest ones of x and y, from the same sample on. last: the path ends here.
        """
        target = path[self._taken :, self.axis]
        if self._coupled:
            target = self._less_coupled(self._coupled, path, commands, last)
        self._taken += len(target)
        self._solved = np.concatenate([self._solved, self._solver.feed(target)])
        if last:
            self._solved = np.concatenate([self._solved, self._solver.finish()])
        return self._solved

    def _less_coupled(
        self, coupled: Coupled, path: Array, commands: Sequence[Array], last: bool
    ) -> Array:
        """Return the target by eq. 19, with the lever arm of Remark 2.1, as far as it is known."""
        start, known = self._fed - coupled.late, min(map(len, commands))
        if last:  # the commands are at rest after their end
            commands = [_longer(each, coupled.late) for each in commands]
            known += coupled.late
        commands = [each[self._fed : known] for each in commands]
        if isinstance(self._solver, _AlongX):
            x = _longer(path[:, X], coupled.late)[self._fed : known] + self._origin[X]
            self._solver.take(commands[self.axis], x)
        self._fed = known
        early = min(max(-start, 0), len(commands[X]))  # samples before the path, at its origin
        place = path[max(start, 0) :][: len(commands[X]) - early]
        at_origin = np.zeros((early, 2))
        added = coupled.run(np.concatenate([at_origin, place]), *commands)[early:]
        return np.asarray(place[:, self.axis] - added)

    def forget(self, n: int) -> None:
        """Drop the first samples, whose command is final in both axes."""
        self._taken -= n
        self._fed -= n
        self._solved = self._solved[n:].copy()


class _Axis:
    """Feeds one axis' solver, which needs whole windows, from pieces of any length."""

    def __init__(self, lpfbs: Lpfbs) -> None:
        self._lpfbs, self._s = lpfbs, lpfbs.rest
        self._preview = lpfbs.window.L_C - lpfbs.window.stride
        self._target = np.zeros(lpfbs.lead)  # for which the command is not final

    def feed(self, target: Array) -> Array:
        """Return the command as far as the preview allows."""
        self._target = np.concatenate([self._target, target])
        stride, following = self._lpfbs.window.stride, max(self._preview, self._lpfbs.lead)
        final = (len(self._target) - following) // stride * stride
        if final <= 0:
            return np.zeros(0)
        x_dm, self._s = self._lpfbs.run(self._target[: final + self._preview], self._s)
        self._target = self._target[final:].copy()  # a view would keep the whole array alive
        return x_dm

    def finish(self) -> Array:
        """Return what is left of the command; the target is at rest after its end."""
        n = len(self._target) - self._lpfbs.lead
        if not n:
            return np.zeros(0)
        x_dm, self._s = self._lpfbs.run(self._lpfbs.whole(self._target), self._s)
        return x_dm[:n]


class _AlongX:
    """Feeds the solvers of an axis whose response changes along x, window by window.

    Targets are less what the previous round's command does, which ``take`` tells.
    """

    def __init__(self, solvers: SolversAlongX) -> None:
        self._solvers, self._s = solvers, solvers.rest
        self._target = np.zeros(solvers.lead)  # for which the command is not final
        self._u = np.zeros(solvers.memory)  # the previous command, and as much before
        self._x = np.zeros(0)  # the path, from the first sample on whose command is not final

    def take(self, u: Array, x: Array) -> None:
        """Take more of the previous command, relative to the origin, and of the path's x, mm."""
        self._u, self._x = np.concatenate([self._u, u]), np.concatenate([self._x, x])

    def feed(self, target: Array) -> Array:
        """Return the command as far as the preview allows."""
        self._target = np.concatenate([self._target, target])
        window = self._solvers.window
        following = max(window.L_C - window.stride, self._solvers.lead)
        return self._windows(max(len(self._target) - following, 0) // window.stride)

    def finish(self) -> Array:
        """Return what is left of the command; the target is at rest after its end."""
        n, window = len(self._target) - self._solvers.lead, self._solvers.window
        if not n:
            return np.zeros(0)
        count = -(-n // window.stride)
        length = (count - 1) * window.stride + window.L_C
        self._target, self._x = (
            _longer(each, max(length - len(each), 0)) for each in (self._target, self._x)
        )
        self._u = _longer(self._u, max(self._solvers.memory + length - len(self._u), 0))
        return self._windows(count)[:n]

    def _windows(self, count: int) -> Array:
        """Return the command of the next windows."""
        solvers, w = self._solvers, self._solvers.window
        made = [np.zeros(0)]
        for a in range(0, count * w.stride, w.stride):
            target, u = self._target[a : a + w.L_C], self._u[a : a + solvers.memory + w.L_C]
            x = float(self._x[a + w.stride // 2])
            command, self._s = solvers.window_command(target, u, x, self._s)
            made.append(command)
        n = count * w.stride
        self._target, self._u, self._x = (
            each[n:].copy() for each in (self._target, self._u, self._x)
        )
        return np.concatenate(made)


def _solver(G: ImpulseResponse, window: Window) -> Lpfbs | SolversAlongX:
    """Return the solver of an axis, or those along x."""
    if G.elsewhere:
        return SolversAlongX(G, window)
    return Lpfbs(G, window)


def _longer(u: Array, n: int) -> Array:
    """Return the samples (k,) and n more of the last of them."""
    return np.pad(u, (0, n), mode="edge") if len(u) else np.zeros(n)


STRATEGIES = {
    strategy.name: strategy
    for strategy in (
        Strategy("none", "no compensation", "#888888", _Uncompensated, lambda plant: None),
        Strategy(
            "fbs", "ringing only", "#c05020",
            partial(FilteredSplines, False), Plant.decoupled,
        ),
        Strategy("racking", "ringing and racking", "#2060a0", partial(FilteredSplines, True)),
    )
}  # fmt: skip


def strategy(name: str) -> Strategy:
    """Return the strategy of that name. Raises HframeError."""
    if name not in STRATEGIES:
        raise HframeError(f"unknown strategy {name!r}: choose one of {', '.join(STRATEGIES)}")
    return STRATEGIES[name]
