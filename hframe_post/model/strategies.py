"""Compensation strategies: none, filtered B-splines, and filtered B-splines with racking.

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
"""

from __future__ import annotations

import math
from collections.abc import Callable
from copy import copy
from dataclasses import dataclass
from functools import partial
from typing import Protocol

import numpy as np

from hframe_post.arrays import Array, X, Y, moved
from hframe_post.errors import ArgumentError, HframeError
from hframe_post.model.impulse_response import FiniteFilter
from hframe_post.model.lpfbs import Lpfbs, Pieces, Window
from hframe_post.model.plant import HEAVIER, Plant


class Compensator:
    """A plant with the certified solvers of its axes. Raises ArgumentError as ``Lpfbs`` does.

    windows: those of x and y, of the same sizes.
    """

    def __init__(self, plant: Plant, windows: tuple[Window, Window]) -> None:
        self.plant = plant
        self.x, self.y = Lpfbs(plant.Gxx, windows[X]), Lpfbs(plant.Gyy, windows[Y])
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
    """Solves x, and then y for its target less what racking adds, if asked."""

    def __init__(self, coupled: bool, compensator: Compensator, origin: Array) -> None:
        self._origin = origin
        self._x, self._y = Pieces(compensator.x), Pieces(compensator.y)
        self._x_dm = self._y_dm = np.zeros(0)  # where only the other is not final
        self._racking = compensator.plant.racking if coupled else None
        if self._racking:
            self._early = self._racking.G.ahead  # θ that comes before the path begins
            self._theta = FiniteFilter(self._racking.G, self._early)
        self._path = np.zeros((0, 2))  # from the origin, where y's target is not known

    def feed(self, xy: Array) -> Array:
        path = moved(xy.T, -self._origin)
        self._path = np.concatenate([self._path, path])
        x_dm = self._x.feed(path[:, X])
        return self._command(x_dm, self._y.feed(self._y_target(x_dm)))

    def finish(self) -> Array:
        x_dm = self._x.finish()
        y_dm = self._y.feed(self._y_target(x_dm))
        if self._racking:  # x rests after its end
            y_d = self._y_target(np.full(self._racking.G.ahead, self._theta.state[-1]))
            y_dm = np.append(y_dm, self._y.feed(y_d))
        return self._command(x_dm, np.append(y_dm, self._y.finish()))

    def _y_target(self, x_dm: Array) -> Array:
        """Return more of y's target by eq. 19, with the lever arm of Remark 2.1."""
        if not self._racking:
            y_d, self._path = self._path[:, Y], self._path[:0]
            return y_d
        theta = self._theta.run(x_dm)
        early = min(self._early, len(theta))
        self._early -= early
        theta = theta[early:]
        path, self._path = self._path[: len(theta)], self._path[len(theta) :].copy()
        return np.asarray(path[:, Y] - self._racking.lever(path + self._origin) * theta)

    def _command(self, x_dm: Array, y_dm: Array) -> Array:
        """Return what is final of the command, with these samples more of x and of y."""
        x_dm, y_dm = np.append(self._x_dm, x_dm), np.append(self._y_dm, y_dm)
        n = min(len(x_dm), len(y_dm))
        self._x_dm, self._y_dm = x_dm[n:].copy(), y_dm[n:].copy()
        return moved((x_dm[:n], y_dm[:n]), self._origin)


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
