"""Commands that dwell while the machine retracts, lifts or waits, and lose no time by it.

Where a strategy's command would go on settling and leading during a stop, it is replaced around
the stop by the one of ``stop_solver``. A stop longer than LONGEST is treated as two: the command
comes to rest on the path, and later sets out from there. So are the ends of a stretch, where the
machine must be at rest where the file believes it to be.

The solution depends only on the samples around the stop and on the command before it, as far as
the plant's responses reach.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Sequence, Set
from dataclasses import replace

import numpy as np

from hframe_post.arrays import Array, E, Z
from hframe_post.model.kinematics import Kinematics
from hframe_post.model.stop_solver import stop_model
from hframe_post.model.strategies import Compensator, strategy
from hframe_post.native.stop import NEAREST, RINGING, SIDE, Stop, StopModel, solve_stops
from hframe_post.printer.settings import STOPS, Motors, Travel
from hframe_post.stream.chunks import stretches
from hframe_post.stream.types import Dwell, Samples, StopRules, frozen

LONGEST = 1000  # samples of a stop that is treated as one
ASIDE = 80  # samples of rest around a longer one, on whose path the command must dwell
BEFORE = SIDE + NEAREST + 2  # samples before and after a stop that its solution depends on
AFTER = SIDE + RINGING + NEAREST + 2
FOREVER = 1 << 60
SHORTEST = "fast"  # of STOPS
AT_REST = StopRules()  # lifts come to rest


def stop_rules(stops: str, strategy: str, lifts: StopRules = AT_REST) -> StopRules:
    """Return how long the path rests at stops for a setting of ``stops``; lifts: see there."""
    if strategy == "none":
        return lifts
    n = 0 if lifts.joined and stops == SHORTEST else STOPS[stops]
    return replace(lifts, before=n, after=n, long_rest=ASIDE, long_from=LONGEST)


class StopModels:
    """What stops have in common, by strategy, without the strategies whose command is the path."""

    def __init__(
        self, compensator: Compensator, names: Iterable[str], travel: Travel, motors: Motors,
        kinematics: Kinematics,
    ) -> None:  # fmt: skip
        self._compensator, self._names = compensator, tuple(names)
        self._bed, self._motors = (travel.x, travel.y), motors.belt_acceleration
        self._belts = kinematics.matrix
        self._latest = compensator, self._of(compensator)

    def at(self, filament: float) -> dict[str, StopModel]:
        """Return those for the bed with this filament (mm) on it; the latest are kept."""
        loaded = self._compensator.at(filament)
        if self._latest[0] is not loaded:
            self._latest = loaded, self._of(loaded)
        return self._latest[1]

    def _of(self, compensator: Compensator) -> dict[str, StopModel]:
        effort = compensator.x.window.effort, compensator.y.window.effort
        plants = {name: strategy(name).assumed(compensator.plant) for name in self._names}
        return {
            name: stop_model(plant, effort, self._belts, self._motors, self._bed)
            for name, plant in plants.items()
            if plant is not None
        }


def dwell_at_stops(chunks: Iterable[Samples], models: StopModels) -> Iterator[Samples]:
    """Yield the stream with commands that dwell at stops, of the strategies with models."""
    for first_chunks in stretches(chunks):
        stretch: _Stretch | None = None
        for chunk in first_chunks:
            if stretch is None and len(chunk):
                stretch = _Stretch(chunk, models.at(float(chunk.xyze[0, E])))
            if stretch is None:
                yield chunk
            else:
                yield from stretch.feed(chunk)
        if stretch is not None:
            yield from stretch.finish()


class _Stretch:
    """One stretch: its stops that are not solved yet, and the chunks that wait for them."""

    def __init__(self, chunk: Samples, models: dict[str, StopModel]) -> None:
        self._window = _Window(chunk, models)
        self._buffered: deque[Samples] = deque()
        # samples from which and before which the command dwells; the stretch begins with one
        self._stops = deque([(-FOREVER, chunk.first + 1)])
        self._arrived = True  # at the first of the stops, which is a long one
        self._free = chunk.first + 1  # end of the last solved stop: from here on a command may move

    def feed(self, chunk: Samples) -> Iterator[Samples]:
        self._window.append(chunk.xyze, chunk.commands)
        others = {k: xy for k, xy in chunk.commands.items() if k not in self._window.names}
        self._buffered.append(replace(chunk, commands=others))
        for event in chunk.events:
            if isinstance(event, Dwell):
                self._add_stop(event.index - 1, event.index + event.samples)
        yield from self._release(self._solve())

    def finish(self) -> Iterator[Samples]:
        """Yield what is left of the stretch, at the end of which the machine dwells."""
        end = self._window.end
        self._window.append_rest(self._window.after)
        self._add_stop(end - 1, FOREVER)
        self._solve()
        yield from self._release(end)

    def _add_stop(self, a: int, b: int) -> None:
        if self._stops and a <= self._stops[-1][1]:  # no motion in between: both are one
            a, before = self._stops[-1]
            self._stops[-1] = (a, max(b, before))
        else:
            self._stops.append((a, b))

    def _solve(self) -> int:
        """Solve the stops whose surroundings are known; return the first sample still needed."""
        window, known = self._window, list[Stop]()
        needed = window.end - 1
        while self._stops:
            a, b = self._stops[0]
            before, long = min(a - self._free, SIDE), b - a > LONGEST
            if long:
                window.solve(known)
                known = self._arrive(a, b, before)
            if window.end < b + window.after:
                needed = min(b if self._arrived else a, needed)
                break
            following = self._stops[1][0] if len(self._stops) > 1 else FOREVER
            after = min(following - b, SIDE)
            if long:
                known.append(Stop(b, b, following, 0, after, movable=False))
            else:
                known.append(Stop(a, b, following, before, after, movable=True))
            self._free, self._arrived = b, False
            self._stops.popleft()
        window.solve(known)
        return needed - BEFORE

    def _arrive(self, a: int, b: int, before: int) -> list[Stop]:
        """Let the command dwell on the path in a long stop; return the stop at its beginning."""
        window, arrived = self._window, self._arrived
        self._arrived |= window.end >= a + window.after
        if self._arrived:
            window.put_on_path(a, b)
        return [Stop(a, a, a, before, 0, movable=False)] if self._arrived and not arrived else []

    def _release(self, end: int) -> Iterator[Samples]:
        """Yield the chunks of which all samples are before ``end``."""
        while self._buffered and self._buffered[0].end <= end:
            chunk = self._buffered.popleft()
            commands = self._window.commands(chunk.first, chunk.end)
            self._window.forget(chunk.end)
            yield replace(chunk, commands={**chunk.commands, **commands})


class _Window:
    """The samples of a stretch that are still needed, counted as in the stream.

    They begin at rest, before the stretch. ``_first`` is the index of the first of them.
    after: samples after a stop that its solution depends on.
    """

    def __init__(self, chunk: Samples, models: dict[str, StopModel]) -> None:
        self._models = models
        self._remembered = BEFORE + max((each.memory for each in models.values()), default=0)
        self.after = AFTER + max((each.ahead for each in models.values()), default=0)
        self._first = chunk.first - self._remembered
        self._xyze = np.repeat(chunk.xyze[:1], self._remembered, axis=0)
        self._commands = dict.fromkeys(models, self._xyze[:, :Z])

    @property
    def names(self) -> Set[str]:
        return self._models.keys()

    @property
    def end(self) -> int:
        return self._first + len(self._xyze)

    def _rows(self, a: int, b: int) -> slice:
        """Return where samples a … b − 1 are in the arrays, as far as these reach."""
        return slice(max(a - self._first, 0), max(b - self._first, 0))

    def append(self, xyze: Array, commands: dict[str, Array]) -> None:
        self._xyze = np.concatenate([self._xyze, xyze])
        for name, known in self._commands.items():
            self._commands[name] = np.concatenate([known, commands[name]])

    def append_rest(self, n: int) -> None:
        last = np.repeat(self._xyze[-1:], n, axis=0)
        self.append(last, dict.fromkeys(self._models, last[:, :Z]))

    def forget(self, end: int) -> None:
        """Drop the samples that nothing depends on once all before ``end`` is final."""
        n = end - self._first - self._remembered
        if n > 0:
            self._xyze, self._first = self._xyze[n:], self._first + n
            self._commands = {name: command[n:] for name, command in self._commands.items()}

    def commands(self, a: int, b: int) -> dict[str, Array]:
        rows = self._rows(a, b)
        return {name: frozen(command[rows].copy()) for name, command in self._commands.items()}

    def put_on_path(self, a: int, b: int) -> None:
        rows = self._rows(a, b)
        for command in self._commands.values():
            command[rows] = self._xyze[rows, :Z]

    def solve(self, stops: Sequence[Stop]) -> None:
        """Let the commands dwell at stops, in the order of time."""
        for name, model in self._models.items():
            if stops:
                solve_stops(self._xyze, self._commands[name], stops, self._first, model)
