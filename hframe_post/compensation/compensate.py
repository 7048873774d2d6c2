"""Samples → samples with commands: x first, θ from it, then y less the racking.

 x_dm : the command whose filtered splines follow x_d                        (eq. 12)
 θ    = Gxθ x_dm, exact, because x_dm is finished                            (eq. 13)
 y_dm : the command whose filtered splines follow y_d − (x_d − x_c)·θ        (eq. 19)

The strategy ``fbs`` leaves out θ, ``none`` commands the path itself. The length of the
stream stays, so marks, z and e keep their samples.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from hframe_post.arrays import TS, Array, X, Y, Z
from hframe_post.model.lpfbs import Lpfbs, Window
from hframe_post.model.plant import LiftedFilter, Plant
from hframe_post.stream.chunks import join, part, stretches
from hframe_post.stream.types import Rests, Samples, frozen

WINDOWS_AT_ONCE = 256  # solved in one matrix product
OUTLASTS = 4096  # samples of standstill in which any stable command settles


class Compensator:
    """A plant with the solvers of its axes. Raises ValueError as ``Lpfbs`` does.

    windows: for x and y, of the same sizes.
    """

    def __init__(self, plant: Plant, windows: tuple[Window, Window]) -> None:
        self.plant = plant
        self.x, self.y = Lpfbs(plant.Gxx, windows[X]), Lpfbs(plant.Gyy, windows[Y])

    def rests(self, velocity: float, acceleration: float, lever: float, tolerance: float) -> Rests:
        """Standstill after which a command has settled, and with which it must lead.

        Both for the fastest start and stop, in x and y at once at ``lever`` mm from x_c: the
        samples for which the command is more than ``tolerance`` mm off the path.
        """
        ramp = np.arange(0.0, velocity + 1e-9, acceleration * TS)
        cruise = np.full(OUTLASTS // 8, velocity)
        moving = np.cumsum(np.concatenate([ramp, cruise, ramp[::-1]])) * TS
        path = np.pad(moving, OUTLASTS, mode="edge")
        path[:OUTLASTS] = 0.0
        xyze = np.column_stack([path, path, np.zeros((len(path), 2))])
        xyze[:, X] += self.plant.x_c + lever
        line = np.zeros(len(path), dtype=np.int64)
        blocks = compensate([Samples(0, xyze, line)], self, ("racking",))
        off = np.concatenate([b.commands["racking"] - b.xyze[:, :Z] for b in blocks])
        beyond = np.flatnonzero(np.abs(off).max(axis=1) > tolerance)
        if not len(beyond):
            return Rests(settle=1, lead=1)
        stopped = OUTLASTS + len(moving)
        return Rests(max(int(beyond[-1]) - stopped, 1), max(OUTLASTS - int(beyond[0]), 1))


def compensate(
    blocks: Iterable[Samples], compensator: Compensator, strategies: tuple[str, ...]
) -> Iterator[Samples]:
    """The same samples with the commands of each strategy.

    Every stretch between pauses that yield the machine starts anew from rest, since the
    machine may then stand elsewhere.
    """
    for stretch in stretches(blocks):
        solver: _Stretch | None = None
        for block in stretch:
            if solver is None and len(block):
                solver = _Stretch(compensator, strategies, block.xyze[0, :Z])
            if solver is not None:
                yield from solver.feed(block)
            else:  # lines before the first known position
                commands = dict.fromkeys(strategies, block.xyze[:, :Z])
                yield Samples(block.first, block.xyze, block.line, block.events, commands)
        if solver is not None:
            yield from solver.finish()


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


class _Stretch:
    """The stream between two places where the machine may move on its own."""

    def __init__(
        self, compensator: Compensator, strategies: tuple[str, ...], origin: Array
    ) -> None:
        plant = compensator.plant
        self._origin, self._x_c, self._names = origin, plant.x_c, strategies
        compensated = [name for name in strategies if name != "none"]
        self._x = _Axis(compensator.x) if compensated else None
        self._y = {name: _Axis(compensator.y) for name in compensated}
        self._theta = LiftedFilter(plant.Gxtheta) if plant.Gxtheta else None
        self._xy: list[Array] = []  # desired, (n, 2), for which θ is not known yet
        self._held: list[Samples] = []
        self._x_ready = np.zeros(0)
        self._y_ready = {name: np.zeros(0) for name in compensated}

    def feed(self, block: Samples) -> Iterator[Samples]:
        """Takes a block, yields what is finished."""
        self._held.append(block)
        if self._x is None:
            yield from self._release(len(block))
            return
        xy = block.xyze[:, :Z] - self._origin
        self._xy.append(xy)
        self._advance(self._x.feed(xy[:, X]), finish=False)
        yield from self._release(min(map(len, self._y_ready.values())))

    def finish(self) -> Iterator[Samples]:
        """The end of the stretch."""
        if self._x is not None:
            self._advance(self._x.finish(), finish=True)
        yield from self._release(sum(map(len, self._held)))

    def _advance(self, x_dm: Array, finish: bool) -> None:
        """y as far as x is known: the targets of eq. 19."""
        if not len(x_dm) and not finish:
            return
        desired = np.concatenate(self._xy) if self._xy else np.zeros((0, 2))
        now, self._xy = desired[: len(x_dm)], [desired[len(x_dm) :]]
        theta = self._theta.run(x_dm) if self._theta is not None else np.zeros(len(x_dm))
        lever = now[:, X] + self._origin[X] - self._x_c
        self._x_ready = np.concatenate([self._x_ready, x_dm])
        for name, axis in self._y.items():
            target = now[:, Y] - lever * theta if name == "racking" else now[:, Y]
            y_dm = axis.feed(target)
            if finish:
                y_dm = np.concatenate([y_dm, axis.finish()])
            self._y_ready[name] = np.concatenate([self._y_ready[name], y_dm])

    def _release(self, n: int) -> Iterator[Samples]:
        """The first ``n`` held samples with their commands."""
        held = sum(map(len, self._held))
        if not self._held or (held and not n):
            return
        whole = join(self._held)
        ready, rest = part(whole, 0, n), part(whole, n, held)
        self._held = [rest] if n < held else []
        commands = {}
        for name in self._names:
            if name == "none":
                commands[name] = ready.xyze[:, :Z]
            else:
                xy = np.column_stack([self._x_ready[:n], self._y_ready[name][:n]])
                commands[name] = frozen(xy + self._origin)
                self._y_ready[name] = self._y_ready[name][n:]
        self._x_ready = self._x_ready[n:]
        yield Samples(ready.first, ready.xyze, ready.line, ready.events, commands)
