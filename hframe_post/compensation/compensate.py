"""Samples → samples with commands: each stretch runs through the courses of its strategies.

The length of the stream stays, so marks, z and e keep their samples. What a strategy does is
in ``model.strategies``.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np

from hframe_post.arrays import TS, Array, X, Z
from hframe_post.model.strategies import Compensator, StrategyState, strategy
from hframe_post.printer.settings import Limits, Travel
from hframe_post.stream.chunks import join, part, stretches
from hframe_post.stream.types import Samples, frozen

OUTLASTS = 4096  # samples of standstill in which any stable command settles
SETTLED = 0.01  # mm off the path


def compensate(
    chunks: Iterable[Samples], compensator: Compensator, names: tuple[str, ...]
) -> Iterator[Samples]:
    """The same samples with the commands of the strategies of these names.

    Every stretch starts anew from rest, since the machine may then stand elsewhere. Raises
    HframeError where no strategy has such a name.
    """
    chosen = [strategy(name) for name in names]
    for stretch in stretches(chunks):
        courses: _Courses | None = None
        for chunk in stretch:
            if courses is None and len(chunk):
                origin = chunk.xyze[0, :Z]
                courses = _Courses({s.name: s.begin(compensator, origin) for s in chosen})
            if courses is not None:
                yield from courses.feed(chunk)
            else:  # lines before the first known position
                yield replace(chunk, commands=dict.fromkeys(names, chunk.xyze[:, :Z]))
        if courses is not None:
            yield from courses.finish()


class _Courses:
    """The strategies at work on one stretch, and the samples that wait for their commands."""

    def __init__(self, courses: dict[str, StrategyState]) -> None:
        self._courses = courses
        self._held: list[Samples] = []
        self._ready = {name: np.zeros((0, 2)) for name in courses}

    def feed(self, chunk: Samples) -> Iterator[Samples]:
        """Takes a chunk, yields what is finished."""
        self._held.append(chunk)
        for name, course in self._courses.items():
            self._add(name, course.feed(chunk.xyze[:, :Z]))
        yield from self._release(min(map(len, self._ready.values()), default=len(chunk)))

    def finish(self) -> Iterator[Samples]:
        """The end of the stretch."""
        for name, course in self._courses.items():
            self._add(name, course.finish())
        yield from self._release(sum(map(len, self._held)))

    def _add(self, name: str, command: Array) -> None:
        if len(command):
            ready = self._ready[name]
            self._ready[name] = np.concatenate([ready, command]) if len(ready) else command

    def _release(self, n: int) -> Iterator[Samples]:
        """The first ``n`` held samples with their commands."""
        held = sum(map(len, self._held))
        if not self._held or (held and not n):
            return
        whole = join(self._held)
        ready, rest = part(whole, 0, n), part(whole, n, held)
        self._held = [rest] if n < held else []
        commands = {name: frozen(xy[:n]) for name, xy in self._ready.items()}
        self._ready = {name: xy[n:] for name, xy in self._ready.items()}
        yield replace(ready, commands=commands)


def settling_samples(compensator: Compensator, limits: Limits, travel: Travel) -> int:
    """Samples of standstill in which any command leads and settles, to SETTLED mm.

    Those of the fastest start and stop, in x and y at once, at the longest lever arm.
    """
    plant = compensator.plant
    lever = max(abs(edge - plant.x_c) for edge in travel.x)
    ramp = np.arange(0.0, limits.velocity + 1e-9, limits.acceleration * TS)
    cruise = np.full(OUTLASTS // 8, limits.velocity)
    moving = np.cumsum(np.concatenate([ramp, cruise, ramp[::-1]])) * TS
    path = np.pad(moving, OUTLASTS, mode="edge")
    path[:OUTLASTS] = 0.0
    xyze = np.column_stack([path, path, np.zeros((len(path), 2))])
    xyze[:, X] += plant.x_c + lever
    line = np.zeros(len(path), dtype=np.int64)
    commanded = compensate([Samples(0, xyze, line)], compensator, ("racking",))
    off = np.concatenate([c.commands["racking"] - c.xyze[:, :Z] for c in commanded])
    beyond = np.flatnonzero(np.abs(off).max(axis=1) > SETTLED)
    if not len(beyond):
        return 1
    stopped = OUTLASTS + len(moving)
    return max(int(beyond[-1]) - stopped, OUTLASTS - int(beyond[0]), 1)
