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

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Protocol

import numpy as np

from hframe_post.arrays import Array, X, Y
from hframe_post.errors import HframeError
from hframe_post.model.lpfbs import Lpfbs, Window
from hframe_post.model.plant import Coupling, Filter, Plant


class Compensator:
    """A plant with the certified solvers of its axes. Raises ArgumentError as ``Lpfbs`` does.

    windows: those of x and y, of the same sizes.
    """

    def __init__(self, plant: Plant, windows: tuple[Window, Window]) -> None:
        self.plant = plant
        self.x, self.y = Lpfbs(plant.Gxx, windows[X]), Lpfbs(plant.Gyy, windows[Y])


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
    """Solves the axes in turn, each for its target less what couplings add, if asked.

    The rows (n, 4) between the stages are x_d, y_d and the latest x_dm, y_dm, from the origin; at
    first these are the path.
    """

    def __init__(self, coupled: bool, compensator: Compensator, origin: Array) -> None:
        couplings = compensator.plant.couplings if coupled else ()
        self._origin, solvers = origin, (compensator.x, compensator.y)
        self._stages = [
            _Stage(axis, solvers[axis], [c for c in couplings if c.answer == axis], origin)
            for axis in order(couplings)
        ]

    def feed(self, xy: Array) -> Array:
        relative = xy - self._origin
        rows = np.hstack([relative, relative])
        for stage in self._stages:
            rows = stage.feed(rows)
        return np.asarray(rows[:, 2:] + self._origin)

    def finish(self) -> Array:
        rows = np.zeros((0, 4))
        for stage in self._stages:
            rows = np.concatenate([stage.feed(rows), stage.finish()])
        return np.asarray(rows[:, 2:] + self._origin)


def order(couplings: Sequence[Coupling]) -> tuple[int, ...]:
    """Return the axes to solve in turn.

    An axis that couplings act on comes after the one whose command they act by. Where x and y act
    on each other or on themselves, a second round meets what the first one changed.
    """
    acting = {(coupling.command, coupling.answer) for coupling in couplings}
    if acting <= {(X, Y)}:
        return X, Y
    return (Y, X) if acting == {(Y, X)} else (X, Y, X, Y)


class _Stage:
    """Solves one axis, from rows whose commands the couplings on it depend on."""

    def __init__(
        self, axis: int, lpfbs: Lpfbs, couplings: Sequence[Coupling], origin: Array
    ) -> None:
        self._axis, self._origin, self._solver = axis, origin, _Axis(lpfbs)
        self._couplings = [(coupling, Filter(coupling.G)) for coupling in couplings]
        self._waiting = np.zeros((0, 4))  # for the axis' command

    def feed(self, rows: Array) -> Array:
        """Take rows (n, 4); return those whose command is final in this axis, (k, 4)."""
        target = rows[:, self._axis]
        for coupling, G in self._couplings:  # eq. 19, with the lever arm of Remark 2.1
            lever = coupling.lever(rows[:, :2] + self._origin)
            target = target - lever * G.run(rows[:, 2 + coupling.command])
        self._waiting = np.concatenate([self._waiting, rows])
        return self._final(self._solver.feed(target))

    def finish(self) -> Array:
        """Return the remaining rows."""
        return self._final(self._solver.finish())

    def _final(self, command: Array) -> Array:
        rows, self._waiting = self._waiting[: len(command)].copy(), self._waiting[len(command) :]
        rows[:, 2 + self._axis] = command
        return rows


class _Axis:
    """Feeds one axis' solver, which needs whole windows, from pieces of any length."""

    def __init__(self, lpfbs: Lpfbs) -> None:
        self._lpfbs, self._s = lpfbs, lpfbs.rest
        self._batch = 256 * lpfbs.window.stride  # this many windows make one matrix product
        self._preview = lpfbs.window.L_C - lpfbs.window.stride
        self._target: list[Array] = []
        self._count = 0

    def feed(self, target: Array) -> Array:
        """Return the command as far as the preview allows, in whole batches."""
        if not len(target):  # an empty view would keep the array it is a view of alive
            return np.zeros(0)
        self._target.append(target)
        self._count += len(target)
        if self._count < self._batch + self._preview:
            return np.zeros(0)
        whole, done = np.concatenate(self._target), []
        while len(whole) >= self._batch + self._preview:
            x_dm, self._s = self._lpfbs.run(whole[: self._batch + self._preview], self._s)
            done.append(x_dm)
            whole = whole[self._batch :]
        self._target, self._count = [whole], len(whole)
        return np.concatenate(done)

    def finish(self) -> Array:
        """Return the rest of the command; the target stands still after its end."""
        n = self._count
        if not n:
            return np.zeros(0)
        target = np.concatenate(self._target)
        pad = -n % self._lpfbs.window.stride + self._preview
        x_dm, self._s = self._lpfbs.run(np.pad(target, (0, pad), mode="edge"), self._s)
        return x_dm[:n]


STRATEGIES = {
    strategy.name: strategy
    for strategy in (
        Strategy("none", "no compensation", "#888888", _Uncompensated, lambda plant: None),
        Strategy(
            "fbs", "ringing only (fbs)", "#c05020",
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
