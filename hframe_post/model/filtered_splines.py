"""Filtered splines as a course, with racking or without; streamed in the order of the equations.

x_dm : the command whose filtered splines follow x_d                        (eq. 12)
θ    = Gxθ x_dm, exact, because x_dm is finished                            (eq. 13)
y_dm : the command whose filtered splines follow y_d − (x_d − x_c)·θ        (eq. 19)
"""

from __future__ import annotations

import numpy as np

from hframe_post.arrays import Array, X, Y
from hframe_post.model.lpfbs import Lpfbs
from hframe_post.model.plant import LiftedFilter
from hframe_post.model.strategy import Compensator

WINDOWS_AT_ONCE = 256  # solved in one matrix product


class FilteredSplines:
    """x first, θ from it, then y, less the racking if asked: a ``Course``."""

    def __init__(self, racking: bool, compensator: Compensator, origin: Array) -> None:
        plant = compensator.plant
        self._origin, self._x_c = origin, plant.x_c
        self._x, self._y = _Axis(compensator.x), _Axis(compensator.y)
        racks = racking and plant.Gxtheta is not None
        self._theta = LiftedFilter(plant.Gxtheta) if racks and plant.Gxtheta else None
        self._desired = np.zeros((0, 2))  # relative to the origin, of which x is not known yet
        self._x_dm = np.zeros(0)  # of which y is not known yet

    def feed(self, xy: Array) -> Array:
        """What is finished once this is known, too."""
        relative = xy - self._origin
        self._desired = np.concatenate([self._desired, relative])
        return self._command(self._y.feed(self._target(self._x.feed(relative[:, X]))))

    def finish(self) -> Array:
        """The rest."""
        y_dm = self._y.feed(self._target(self._x.finish()))
        return self._command(np.concatenate([y_dm, self._y.finish()]))

    def _target(self, x_dm: Array) -> Array:
        """What y must follow, (k,), as far as x is known: eq. 19."""
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
    """One axis: takes its target in any pieces, gives its command in whole batches."""

    def __init__(self, lpfbs: Lpfbs) -> None:
        self._lpfbs, self._s = lpfbs, lpfbs.rest
        self._batch = WINDOWS_AT_ONCE * lpfbs.window.stride
        self._preview = lpfbs.window.L_C - lpfbs.window.stride
        self._target: list[Array] = []
        self._count = 0

    def feed(self, target: Array) -> Array:
        """The command as far as the preview allows."""
        if not len(target):  # a view of nothing would keep all that it is a view of
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
        """The rest of the command; the target stands still after its end."""
        n = self._count
        if not n:
            return np.zeros(0)
        target = np.concatenate(self._target)
        stride = self._lpfbs.window.stride
        pad = -n % stride + self._preview
        x_dm, self._s = self._lpfbs.run(np.pad(target, (0, pad), mode="edge"), self._s)
        return x_dm[:n]
