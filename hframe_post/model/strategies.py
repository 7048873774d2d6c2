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
from hframe_post.model.impulse_response import FiniteFilter
from hframe_post.model.lpfbs import Lpfbs, Pieces, Window
from hframe_post.model.plant import HEAVIER, Coupling, Plant
from hframe_post.model.rounds import order, rounds_needed


class Compensator:
    """A plant with the certified solvers of its axes. Raises ArgumentError as ``Lpfbs`` does.

    windows: those of x and y, of the same sizes.
    """

    def __init__(self, plant: Plant, windows: tuple[Window, Window]) -> None:
        self.plant = plant
        self.x, self.y = Lpfbs(plant.Gxx, windows[X]), Lpfbs(plant.Gyy, windows[Y])
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
            loaded.y = Lpfbs(loaded.plant.Gyy, self.y.window)
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
        self._stages = [
            _Stage(axis, solvers[axis], [c for c in couplings if c.answer == axis], origin)
            for axis in order(couplings, compensator.rounds)
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

    Samples are counted from the first whose command is not final.
    """

    def __init__(
        self, axis: int, lpfbs: Lpfbs, couplings: Sequence[Coupling], origin: Array
    ) -> None:
        self.axis, self._couplings, self._origin = axis, couplings, origin
        self._late = max((coupling.G.ahead for coupling in couplings), default=0)
        self._filters = [FiniteFilter(coupling.G, self._late) for coupling in couplings]
        self._pieces = Pieces(lpfbs)
        self._fed = 0  # samples of which the couplings know the commands
        self._solved = np.zeros(0)

    def solve(self, path: Array, commands: Sequence[Array], last: bool) -> Array:
        """Return what is final of the axis' command, for the path (n, 2) from the origin.

        commands: the latest ones of x and y, from the same sample on. last: the path ends here.
        """
        if last:  # the commands are at rest after their end
            commands = [_longer(each, self._late) for each in commands]
        target = self._less_coupled(path, commands)
        self._solved = np.concatenate([self._solved, self._pieces.feed(target)])
        if last:
            self._solved = np.concatenate([self._solved, self._pieces.finish()])
        return self._solved

    def _less_coupled(self, path: Array, commands: Sequence[Array]) -> Array:
        """Return more of the target by eq. 19, with the lever arm of Remark 2.1."""
        known, late = min(map(len, commands)), self._late
        path = path[max(self._fed - late, 0) : max(known - late, 0)]
        added = np.zeros(len(path))
        for coupling, G in zip(self._couplings, self._filters, strict=True):
            output = G.run(commands[coupling.command][self._fed : known])
            lever = coupling.lever(path + self._origin)
            added += lever * output[len(output) - len(path) :]  # the first are before the path
        self._fed = known
        return np.asarray(path[:, self.axis] - added)

    def forget(self, n: int) -> None:
        """Drop the first samples, whose command is final in both axes."""
        self._fed -= n
        self._solved = self._solved[n:].copy()


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
