"""Commands that stand while the machine retracts, lifts or waits, and lose no time by it.

Where a strategy's command would go on settling and leading through what happens at rest,
it is replaced around the stop by the one of ``model.stop``. A stop that lasts longer than
LONGEST is two: the command comes to rest on the path, and later begins from there. So do the ends
of a stretch, where the machine must stand where the file believes it.

What is decided at a stop depends on nothing but the samples around it and on the true state of
the plant before it. That is carried from stop to stop where these are near one another; a plant
that has not stopped for long is followed from REMEMBERED samples before, since it has forgotten
all else.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from hframe_post.arrays import Array, E, Z
from hframe_post.model.stop import StopSolver
from hframe_post.model.stop_cost import BESIDE, BEYOND, NEAREST, Stop, Surroundings
from hframe_post.model.stop_plant import State
from hframe_post.model.strategies import Compensator, strategy
from hframe_post.model.transfer_function import BLOCK_SAMPLES
from hframe_post.printer.settings import STOPS, Printer
from hframe_post.stream.chunks import join, part, stretches
from hframe_post.stream.types import Pause, Rests, Samples, frozen

ASIDE = 80  # samples around a stop that is two, on whose path the command must stand
REMEMBERED = 32 * BLOCK_SAMPLES  # after so many, any plant has forgotten its state
LONGEST = 1000  # samples of a stop that is one: likewise
BEFORE = BESIDE + NEAREST + 2  # samples that a solution may look at before a stop
AFTER = BESIDE + BEYOND + NEAREST + 2
FOREVER = 1 << 60
AT_REST = Rests()  # lifts come to rest


def rests(stops: str, strategy: str, passing: Rests = AT_REST) -> Rests:
    """Standstill of the path around stops of that kind; a command that is the path needs none.

    passing: how lifts pass into motion.
    """
    if strategy == "none":
        return passing
    n = STOPS[stops]
    return replace(passing, before=n, after=n, aside=ASIDE, long=LONGEST)


def stop_solvers(
    compensator: Compensator, names: Iterable[str], printer: Printer
) -> dict[str, StopSolver]:
    """Solvers of the strategies of these names, but of those whose command is the path."""
    effort = compensator.x.window.effort, compensator.y.window.effort
    belts, motors = printer.kinematics.matrix, printer.motors.belt_acceleration
    bed = printer.travel.x, printer.travel.y
    believed = {name: strategy(name).assumed(compensator.plant) for name in names}
    return {
        name: StopSolver(plant, effort, belts, motors, bed)
        for name, plant in believed.items()
        if plant is not None
    }


def hold_at_stops(chunks: Iterable[Samples], solvers: dict[str, StopSolver]) -> Iterator[Samples]:
    """The stream with commands that stand where the machine does something else.

    solvers: by strategy; the commands of others stay as they are.
    """
    for stretch in stretches(chunks):
        course: _Course | None = None
        for chunk in stretch:
            if course is None and len(chunk):
                course = _Course(chunk, solvers)
            if course is None:
                yield chunk
            else:
                yield from course.feed(chunk)
        if course is not None:
            yield from course.finish()


@dataclass
class _Command:
    """One strategy's command (n, 2) from the origin; the plant's state before one of its blocks."""

    solver: StopSolver
    samples: Array
    state: State


class _Course:
    """One stretch: what is held of it, and the stands that are not solved yet.

    Arrays begin at sample ``_zero``, on a grid of blocks of the plant's filters, with the
    standstill from which the stretch begins.
    """

    def __init__(self, chunk: Samples, solvers: dict[str, StopSolver]) -> None:
        self._origin, self._e = chunk.xyze[0, :Z], chunk.xyze[:1, E]
        self._held: list[Samples] = []
        self._zero = chunk.first - BEFORE
        self._path = np.zeros((BEFORE, 2))
        self._extruding = np.zeros(BEFORE, dtype=bool)
        self._commands = {
            name: _Command(solver, np.zeros((BEFORE, 2)), solver.filters.rest)
            for name, solver in solvers.items()
        }
        self._since = 0  # the sample of the arrays before which the commands' states are
        self._stands = [(-FOREVER, chunk.first + 1)]
        self._left = True  # the first of the stands has been come to rest on
        self._solved = chunk.first + 1  # end of the last stand that is behind

    def feed(self, chunk: Samples) -> Iterator[Samples]:
        """Takes a chunk, yields what is finished."""
        self._held.append(chunk)
        self._extend(chunk.xyze, chunk.commands)
        for event in chunk.events:
            if isinstance(event, Pause):
                self._add(event.index - 1, event.index + event.samples)
        yield from self._release(self._advance())

    def finish(self) -> Iterator[Samples]:
        """The end of the stretch, where the machine stands on."""
        end = self._end
        last = np.tile([*(self._path[-1] + self._origin), 0.0, self._e[0]], (AFTER, 1))
        self._extend(last, dict.fromkeys(self._commands, last[:, :Z]))
        self._add(end - 1, FOREVER)
        self._advance()
        yield from self._release(end)

    # ------------------------------------------------------------------ samples in and out

    @property
    def _end(self) -> int:
        return self._zero + len(self._path)

    def _extend(self, xyze: Array, commands: dict[str, Array]) -> None:
        path, e = xyze[:, :Z] - self._origin, xyze[:, E]
        x, y = np.concatenate([self._path[-1:], path]).T
        moving = (x[1:] != x[:-1]) | (y[1:] != y[:-1])
        extruding = moving & (np.diff(e, prepend=self._e) > 0.0)
        self._e = e[-1:] if len(e) else self._e
        self._path = np.concatenate([self._path, path])
        self._extruding = np.concatenate([self._extruding, extruding])
        for name, command in self._commands.items():
            command.samples = np.concatenate([command.samples, commands[name] - self._origin])

    def _release(self, end: int) -> Iterator[Samples]:
        """The held samples before ``end``; what no solution will look at is let go."""
        whole = join(self._held)
        n = min(end - whole.first, len(whole))
        if n <= 0 and len(whole):
            return
        ready = part(whole, 0, n)
        self._held = [part(whole, n, len(whole))]
        at = slice(whole.first - self._zero, whole.first - self._zero + n)
        commands = {
            name: frozen(command.samples[at] + self._origin)
            for name, command in self._commands.items()
        }
        self._forget((end - self._zero - REMEMBERED) // BLOCK_SAMPLES * BLOCK_SAMPLES)
        yield replace(ready, commands={**ready.commands, **commands})

    def _forget(self, n: int) -> None:
        """The first n samples of the arrays."""
        if n <= 0:
            return
        for command in self._commands.values():
            command.samples = command.samples[n:]
        self._path, self._extruding = self._path[n:], self._extruding[n:]
        self._zero, self._since = self._zero + n, self._since - n

    def _carry(self, n: int) -> None:
        """The plant's states up to the block that begins at n, beyond which all may change."""
        if n - REMEMBERED > self._since:
            self._since = n - REMEMBERED
            for command in self._commands.values():
                command.state = command.solver.filters.at_rest(command.samples[self._since])
        if n > self._since:
            for command in self._commands.values():
                done = command.samples[self._since : n]
                command.state = command.solver.filters.after(command.state, done)
            self._since = n

    # ------------------------------------------------------------------ stands

    def _add(self, a: int, b: int) -> None:
        """A stand, joined to the one before if no motion lies between them."""
        if self._stands and a <= self._stands[-1][1]:
            a, before = self._stands[-1]
            self._stands[-1] = (a, max(b, before))
        else:
            self._stands.append((a, b))

    def _advance(self) -> int:
        """Solves what can be; the sample from which on anything may change or be looked at."""
        while self._stands:
            a, b = self._stands[0]
            long = b - a > LONGEST
            if long and not self._left and self._end >= a + AFTER:
                self._pin(a, b)
                self._solve(Stop(a, a, min(a - self._solved, BESIDE), 0, False, a))
                self._left = True
            if self._left:
                self._pin(a, b)
            if self._end < b + AFTER:
                return min(b if self._left else a, self._end - 1) - BEFORE
            following = self._stands[1][0] if len(self._stands) > 1 else FOREVER
            after = min(following - b, BESIDE)
            if long:
                self._solve(Stop(b, b, 0, after, False, following))
            else:
                before = min(a - self._solved, BESIDE)
                self._solve(Stop(a, b, before, after, True, following))
            self._solved, self._left = b, False
            del self._stands[0]
        return self._end - 1 - BEFORE

    def _pin(self, a: int, b: int) -> None:
        """The command stands on the path from sample a to b − 1."""
        at = slice(max(a - self._zero, 0), max(b - self._zero, 0))
        for command in self._commands.values():
            command.samples[at] = self._path[at]

    def _solve(self, stop: Stop) -> None:
        """Every strategy's command around a stop; its places count samples."""
        at = replace(
            stop, a=stop.a - self._zero, b=stop.b - self._zero, ends=stop.ends - self._zero
        )
        around = Surroundings(self._path, self._origin, self._extruding)
        changed = slice(at.a - BESIDE, at.b + BESIDE)
        self._carry(changed.start // BLOCK_SAMPLES * BLOCK_SAMPLES)
        for command in self._commands.values():
            between = command.samples[self._since : changed.start]
            z = command.solver.filters.after(command.state, between)
            command.samples[changed] = command.solver.solve(around, command.samples, z, at)
