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

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Protocol

import numpy as np

from hframe_post.arrays import Array, X, Y
from hframe_post.errors import HframeError
from hframe_post.model.lpfbs import Lpfbs, Window
from hframe_post.model.plant import Filter, Plant


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
    """Solves x, derives θ from it, then solves y, less the racking if asked."""

    def __init__(self, racking: bool, compensator: Compensator, origin: Array) -> None:
        plant = compensator.plant
        self._origin, self._x_c = origin, plant.x_c
        self._x, self._y = _Axis(compensator.x), _Axis(compensator.y)
        self._theta = Filter(plant.Gxtheta) if racking and plant.Gxtheta else None
        self._desired = np.zeros((0, 2))  # from the origin; x_dm is not final for these samples
        self._x_dm = np.zeros(0)  # y_dm is not final for these samples

    def feed(self, xy: Array) -> Array:
        relative = xy - self._origin
        self._desired = np.concatenate([self._desired, relative])
        return self._command(self._y.feed(self._y_target(self._x.feed(relative[:, X]))))

    def finish(self) -> Array:
        y_dm = self._y.feed(self._y_target(self._x.finish()))
        return self._command(np.concatenate([y_dm, self._y.finish()]))

    def _y_target(self, x_dm: Array) -> Array:
        """Return what y must follow (eq. 19) at the next final samples of x_dm, both (k,)."""
        now, self._desired = self._desired[: len(x_dm)], self._desired[len(x_dm) :]
        self._x_dm = np.concatenate([self._x_dm, x_dm])
        if self._theta is None or not len(x_dm):
            return now[:, Y]
        lever = now[:, X] + self._origin[X] - self._x_c
        return np.asarray(now[:, Y] - lever * self._theta.run(x_dm))

    def _command(self, y_dm: Array) -> Array:
        x_dm, self._x_dm = self._x_dm[: len(y_dm)], self._x_dm[len(y_dm) :]
        return np.column_stack([x_dm, y_dm]) + self._origin


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
            partial(FilteredSplines, False), lambda plant: replace(plant, Gxtheta=None),
        ),
        Strategy("racking", "ringing and racking", "#2060a0", partial(FilteredSplines, True)),
    )
}  # fmt: skip


def strategy(name: str) -> Strategy:
    """Return the strategy of that name. Raises HframeError."""
    if name not in STRATEGIES:
        raise HframeError(f"unknown strategy {name!r}: choose one of {', '.join(STRATEGIES)}")
    return STRATEGIES[name]
