"""Samples → samples with commands: each stretch runs through its strategies.

The stream keeps its length, so marks, z and e keep their samples. What a strategy does is in
``model.strategies``.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import product

import numpy as np

from hframe_post.arrays import TS, Array, E, Z
from hframe_post.model.kinematics import Kinematics
from hframe_post.model.strategies import Compensator, StrategyState, strategy
from hframe_post.printer.settings import Limits, Travel
from hframe_post.stream.chunks import stretches
from hframe_post.stream.types import Samples, frozen

SETTLED = 1e-4  # mm; a few µm of the command decide over as much of the nozzle's error


def compensate(
    chunks: Iterable[Samples], compensator: Compensator, names: tuple[str, ...]
) -> Iterator[Samples]:
    """Yield the same samples with the commands of the strategies of these names.

    Every stretch starts again from rest, with the bed as heavy as it is by then. Raises
    HframeError for an unknown strategy, or where the bed gets too heavy for a window.
    """
    chosen = [strategy(name) for name in names]
    for stretch in stretches(chunks):
        states: _States | None = None
        for chunk in stretch:
            if states is None and len(chunk):
                origin, loaded = chunk.xyze[0, :Z], compensator.at(float(chunk.xyze[0, E]))
                states = _States({s.name: s.begin(loaded, origin) for s in chosen})
            if states is not None:
                yield from states.feed(chunk)
            else:  # lines before the first known position
                yield replace(chunk, commands=dict.fromkeys(names, chunk.xyze[:, :Z]))
        if states is not None:
            yield from states.finish()


class _States:
    """The strategies at work on one stretch, and the samples that wait for their commands."""

    def __init__(self, states: dict[str, StrategyState]) -> None:
        self._states = states
        self._waiting: deque[Samples] = deque()
        self._ready = {name: np.zeros((0, 2)) for name in states}

    def feed(self, chunk: Samples) -> Iterator[Samples]:
        self._waiting.append(chunk)
        for name, state in self._states.items():
            self._add(name, state.feed(chunk.xyze[:, :Z]))
        yield from self._released()

    def finish(self) -> Iterator[Samples]:
        for name, state in self._states.items():
            self._add(name, state.finish())
        yield from self._released()

    def _add(self, name: str, command: Array) -> None:
        self._ready[name] = np.concatenate([self._ready[name], command])

    def _released(self) -> Iterator[Samples]:
        """Yield the chunks that have all their commands."""
        while self._waiting:
            n, ready = len(self._waiting[0]), self._ready
            if any(len(rows) < n for rows in ready.values()):
                return
            commands = {name: frozen(rows[:n]) for name, rows in ready.items()}
            self._ready = {name: rows[n:] for name, rows in ready.items()}
            yield replace(self._waiting.popleft(), commands=commands)


def settling_samples(compensator: Compensator, limits: Limits, travel: Travel) -> int:
    """Return the samples of rest in which any command leads and settles, to SETTLED.

    They are those of the fastest start and stop, in x and y at once, from the bed's corners.
    """
    long = 4096  # samples of rest in which any stable command settles
    ramp = np.arange(0.0, limits.velocity + 1e-9, limits.acceleration * TS)
    cruise = np.full(long // 8, limits.velocity)
    moving = np.cumsum(np.concatenate([ramp, cruise, ramp[::-1]])) * TS
    path = np.pad(moving, long, mode="edge")
    path[:long] = 0.0
    stopped, needed = long + len(moving), [1]
    for corner in product(travel.x, travel.y):
        whole = np.column_stack([path, path]) + corner
        off = _whole(whole, compensator, "racking") - whole
        beyond = np.flatnonzero(np.abs(off).max(axis=1) > SETTLED)
        if len(beyond):
            needed += [int(beyond[-1]) - stopped, long - int(beyond[0])]
    return max(needed)


def hardest(compensator: Compensator, name: str, kinematics: Kinematics, place: Array) -> float:
    """Return how hard belts accelerate in commands for the hardest path at a place (2,), mm.

    That is times the acceleration of its own belts: the sum of the command's response to theirs.
    """
    long = 1024  # samples in which the response to a change of speed ends
    way = TS * np.cumsum(np.repeat([0.0, 1.0, 0.0], [long, 2 * long, long]))
    commands = [_whole(place + np.outer(way, axis), compensator, name) for axis in np.eye(2)]
    responses = np.diff(np.stack(commands, axis=-1), n=2, axis=0)[: 2 * long] / TS
    by_belts = kinematics.matrix @ responses @ np.linalg.inv(kinematics.matrix)
    return float(np.abs(by_belts).sum(axis=(0, 2)).max())


def _whole(path: Array, compensator: Compensator, name: str) -> Array:
    """Return the command (n, 2) of a strategy for a whole path."""
    state = strategy(name).begin(compensator, path[0])
    return np.concatenate([state.feed(path), state.finish()])
