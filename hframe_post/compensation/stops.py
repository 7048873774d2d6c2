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
from collections.abc import Iterable, Iterator, Sequence
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
    """One stretch, which begins at rest: its stops that are not solved yet, and what they need.

    The samples of ``_past`` are yielded already; those of ``_waiting`` may still change.
    """

    def __init__(self, chunk: Samples, models: dict[str, StopModel]) -> None:
        self._models = models
        # samples before and after a stop that its solution depends on
        self._before = BEFORE + max((each.memory for each in models.values()), default=0)
        self._after = AFTER + max((each.ahead for each in models.values()), default=0)
        self._past = deque([self._rest(chunk.xyze[0], chunk.first - self._before, self._before)])
        self._waiting = deque[Samples]()
        # samples from which and before which the command dwells; the stretch begins with one
        self._stops = deque([(-FOREVER, chunk.first + 1)])
        self._arrived = True  # at the first of the stops, which is a long one
        self._free = chunk.first + 1  # end of the last solved stop: from here on a command may move

    def _rest(self, where: Array, first: int, samples: int) -> Samples:
        xyze = np.repeat(where[None], samples, axis=0)
        commands = dict.fromkeys(self._models, xyze[:, :Z])
        return Samples(first, xyze, np.zeros(samples, np.int64), commands=commands)

    @property
    def _end(self) -> int:
        return (self._waiting or self._past)[-1].end

    def feed(self, chunk: Samples) -> Iterator[Samples]:
        self._waiting.append(chunk)
        for event in chunk.events:
            if isinstance(event, Dwell):
                self._add_stop(event.index - 1, event.index + event.samples)
        yield from self._release(self._solve())

    def finish(self) -> Iterator[Samples]:
        """Yield what is left of the stretch, at the end of which the machine dwells."""
        end = self._end
        last = next(each for each in (*reversed(self._waiting), *reversed(self._past)) if len(each))
        self._waiting.append(self._rest(last.xyze[-1], end, self._after))
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
        known, end = list[Stop](), self._end
        needed = end - 1
        while self._stops:
            a, b = self._stops[0]
            before, long = min(a - self._free, SIDE), b - a > LONGEST
            if long:
                self._dwell_at(known)
                known = self._arrive(a, b, before)
            if end < b + self._after:
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
        self._dwell_at(known)
        return needed - BEFORE

    def _arrive(self, a: int, b: int, before: int) -> list[Stop]:
        """Let the command dwell on the path in a long stop; return the stop at its beginning."""
        arrived = self._arrived
        self._arrived |= self._end >= a + self._after
        if self._arrived:
            first, end = max(a, self._waiting[0].first), min(b, self._end)
            path, _ = self._cut(first, end)
            self._change(first, end, dict.fromkeys(self._models, path[:, :Z]))
        return [Stop(a, a, a, before, 0, movable=False)] if self._arrived and not arrived else []

    def _dwell_at(self, stops: Sequence[Stop]) -> None:
        """Let the commands dwell at stops, in the order of time."""
        if not stops or not self._models:
            return
        a, b = stops[0].a, stops[-1].b
        first = a - self._before
        path, commands = self._cut(first, b + self._after)
        for name, model in self._models.items():
            solve_stops(path, commands[name], stops, first, model)
        changed = slice(a - SIDE - first, b + SIDE - first)
        self._change(a - SIDE, b + SIDE, {name: xy[changed] for name, xy in commands.items()})

    def _cut(self, a: int, b: int) -> tuple[Array, dict[str, Array]]:
        """Return path and commands of samples a … b − 1, which are all known."""
        cut = [
            (each, slice(max(a - each.first, 0), b - each.first))
            for each in (*self._past, *self._waiting)
            if each.first < b and each.end > a
        ]
        path = np.concatenate([each.xyze[rows] for each, rows in cut])
        return path, {
            name: np.concatenate([each.commands[name][rows] for each, rows in cut])
            for name in self._models
        }

    def _change(self, a: int, b: int, commands: dict[str, Array]) -> None:
        """Replace the commands of samples a … b − 1, as far as these wait."""
        for k, chunk in enumerate(self._waiting):
            low, high = max(a, chunk.first), min(b, chunk.end)
            if low < high:
                changed = {name: chunk.commands[name].copy() for name in commands}
                for name, xy in commands.items():
                    changed[name][low - chunk.first : high - chunk.first] = xy[low - a : high - a]
                self._waiting[k] = replace(chunk, commands={**chunk.commands, **changed})

    def _release(self, end: int) -> Iterator[Samples]:
        """Yield the chunks of which all samples are before ``end``."""
        while self._waiting and self._waiting[0].end <= end:
            chunk = self._waiting.popleft()
            self._past.append(chunk)
            while self._past[0].end <= chunk.end - self._before:
                self._past.popleft()
            for name in self._models:
                frozen(chunk.commands[name])
            yield chunk
