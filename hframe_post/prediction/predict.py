"""Prediction of the nozzle's motion: commands through the plant, compared with the path.

A stream is judged window by window. Each brings the samples before and after it on which its own
depend, so that it is as exact as the whole. Racking is that at the actual x (eq. 2), not at x_d.
The contour error is the distance to the path, not to the desired place at that time.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hframe_post.arrays import TS, Array, Flags, Integers, Z
from hframe_post.model.impulse_response import CoarseFilter
from hframe_post.model.kinematics import Kinematics
from hframe_post.model.plant import Plant
from hframe_post.model.strategies import STRATEGIES
from hframe_post.native.judging import distances, judge_window, play
from hframe_post.native.stop import NEAREST
from hframe_post.prediction.doubts import Doubts
from hframe_post.prediction.windows import Window, Windows
from hframe_post.printer.settings import Steps
from hframe_post.stream.chunks import part, stretches, with_neighbours
from hframe_post.stream.types import Samples, frozen

COMPENSATING = STRATEGIES.keys() - {"none"}


SHOWN_EVERY = 4  # samples of windows that are only shown; ringing at 50 Hz takes 20


@dataclass(frozen=True, slots=True)
class Judgement:
    """How well each of s strategies follows the samples of a window, at the k of them that count.

    every: samples from one that counts to the next, while the path moves. at (k,): their indices;
    extruding (k,): which of them extrude. errors (k, s): distance to the path; off (k, s, 2): the
    way to the nozzle from the nearest place on the path. nozzle (s, m, 2): its x, y at all samples,
    or ``apart`` from ``begin`` on. mm.

    Of some of these samples, numbered by doubtful (d,), strategy → ``products`` (d, SUMS) say what
    is not known of the error; without doubts they are empty.
    """

    window: Window
    strategies: tuple[str, ...]
    every: int
    begin: int
    apart: int
    at: Integers
    extruding: Flags
    nozzle: Array
    off: Array
    errors: Array
    doubtful: Integers
    products: dict[str, Array]

    @property
    def chunk(self) -> Samples:
        """Return the samples of the window itself."""
        return part(self.window.piece, self.window.start, self.window.stop)

    @property
    def contour(self) -> dict[str, Array]:
        """Return the distance to the path by strategy, (k,), mm."""
        return dict(zip(self.strategies, self.errors.T, strict=True))

    @property
    def motion(self) -> dict[str, Array]:
        """Return the nozzle's x, y by strategy, (m, 2), mm."""
        return dict(zip(self.strategies, self.nozzle, strict=True))

    def tracking(self, strategy: str) -> Array:
        """Return the deviation from the desired place at the same time, (k, 2), mm."""
        places = self.motion[strategy].take((self.at - self.begin) // self.apart, axis=0)
        path = self.window.piece.xyze[self.window.start + self.at, :Z]
        return np.asarray(places - path)


class Nozzle:
    """The nozzle of a plant, at half the rate.

    past, ahead: samples of a command that a piece needs before it and after it.
    """

    def __init__(self, plant: Plant) -> None:
        filters, self._x_c = [CoarseFilter(G) for G in plant.responses], plant.x_c
        self._taps = np.concatenate([each.taps for each in filters])
        self._counts = np.array([len(each.taps) for each in filters])
        self._late = np.array([each.ahead for each in filters])
        self._gains = np.array([[each.rest, each.lag] for each in filters])
        self.past = max(each.past for each in filters)
        self.ahead = max(each.ahead for each in filters)

    def judged(
        self, xyze: Array, sliced: bool, commands: Array, first: int, begin: int, stop: int,
        every: int, apart: int,
    ) -> tuple[Integers, Flags, Array, Array, Array]:  # fmt: skip
        """Return at, extruding, nozzle, off and errors of a ``Judgement`` of commands (s, n, 2).

        sliced: judge the path as a command, too, before the others.
        first, begin: of the samples before ``stop`` of a path xyze (n, 4) that are judged, and of
        those at which the nozzle is.
        """
        own = self._taps, self._counts, self._late, self._gains, self._x_c
        s, cut = sliced + len(commands), (first, begin, stop, every, apart)
        at, extruding, nozzle, off, errors = judge_window(xyze, sliced, commands, *own, *cut)
        nozzle = nozzle.reshape(s, len(range(begin, stop, apart)), 2)
        return at, extruding, nozzle, off.reshape(len(at), s, 2), errors


class Judge:
    """Judges windows of commands on a plant, at every n-th sample (n = ``every``) of the print.

    doubts: what is not known of the plant. before, after: samples that a window needs around it.
    """

    def __init__(self, plant: Plant, every: int = 1, doubts: Doubts | None = None) -> None:
        self._plant, self._every, self._doubts = plant, every, doubts
        self._load, self._nozzle = 0, Nozzle(plant.loaded(0))
        self.before = max(self._nozzle.past, NEAREST, doubts.past if doubts else 0)
        self.after = max(self._nozzle.ahead, NEAREST + 1, doubts.ahead if doubts else 0)

    def judged(
        self, window: Window, played: Sequence[Played] = (), sliced: bool = False
    ) -> Judgement:
        """Return the judgement of a window.

        played: of commands whose lines are judged instead. sliced: judge the path itself, too, as
        the command without compensation, unless there is one.
        """
        piece, start, stop = window.piece, window.start, window.stop
        names, sliced = tuple(piece.commands), sliced and "none" not in piece.commands
        commands = np.array([*piece.commands.values()]).reshape(len(names), len(piece), 2)
        for each in played:
            if each.strategy in names:
                each.write(piece.first, commands[names.index(each.strategy)])
        every, apart = (self._every, 1) if window.weight else (SHOWN_EVERY, SHOWN_EVERY)
        first, begin = (start + -(piece.first + start) % each for each in (every, apart))
        cut = first, begin, stop, every, apart
        at, extruding, nozzle, off, errors = self._at(window).judged(
            piece.xyze, sliced, commands, *cut
        )
        which, products = np.zeros(0, np.int64), dict[str, Array]()
        if self._doubts is not None and window.weight:
            own = dict(zip(names, commands, strict=True))
            which, products = self._doubts.along(piece, own, at, off[:, sliced:])
        known = nozzle, off, errors, which, products
        names = ("none", *names) if sliced else names
        return Judgement(
            window, names, every, begin - start, apart, at - start, extruding, *known
        )  # fmt: skip

    def _at(self, window: Window) -> Nozzle:
        """Return the nozzle with a window's filament on the bed."""
        load = self._plant.load(window.filament)
        if load != self._load:
            self._load, self._nozzle = load, Nozzle(self._plant.loaded(load))
        return self._nozzle


def judge(
    chunks: Iterable[Samples], plant: Plant, every: int = 1, doubts: Doubts | None = None
) -> Iterator[Judgement]:
    """Yield judgements of all windows of a stream, at every n-th sample at which the path moves."""
    own = Judge(plant, every, doubts)
    yield from map(own.judged, Windows(own.before, own.after).of(chunks))


class Played:
    """The motion of the lines of a strategy's command, noted as they are written.

    until: the sample before which all lines are.
    """

    def __init__(self, strategy: str) -> None:
        self.strategy, self.until = strategy, 0
        self._segments = deque[tuple[Integers, Array]]()  # their beginnings and ends, in turn

    def add(self, begin: Integers, end: Integers, at: Array) -> None:
        """Add segments, from samples begin to end (k,), between places (k + 1, ≥2), mm."""
        ends = np.column_stack([begin, end]).ravel()
        places = at[:, :Z].repeat(2, axis=0)[1:-1]
        self._segments.append((ends, np.ascontiguousarray(places)))

    def motion(self, piece: Samples) -> Samples:
        """Return a piece with this motion as the command. The next one begins no earlier."""
        if self.strategy not in piece.commands:
            return piece
        command = piece.commands[self.strategy].copy()
        self.write(piece.first, command)
        return replace(piece, commands={**piece.commands, self.strategy: frozen(command)})

    def write(self, first: int, command: Array) -> None:
        """Write this motion into a command (n, 2) whose first sample is no earlier next time."""
        while self._segments and self._segments[0][0][-1] < first:
            self._segments.popleft()
        for ends, at in self._segments:
            play(ends, at, first, command)


def quantise(chunks: Iterable[Samples], kinematics: Kinematics, steps: Steps) -> Iterator[Samples]:
    for stretch in stretches(chunks):
        for chunk, wide, where in with_neighbours(stretch, 1, 1):
            commands = {
                name: frozen(stepped(command, kinematics, steps)[where])
                for name, command in wide.commands.items()
            }
            yield replace(chunk, commands=commands)


def stepped(command: Array, kinematics: Kinematics, steps: Steps) -> Array:
    """Return the command (n, 2) with both belts in whole steps, (n, 2).

    A sample is the mean over the ticks of the millisecond around it, since carriage and belts do
    not follow a single step at 40 kHz. The command is interpolated at the ticks.
    """
    ticks = max(round(steps.clock_hz * TS), 1)
    belts = kinematics.belts(*command.T).T / steps.belt
    before, after = (
        np.diff(belts, axis=0, prepend=belts[:1]),
        np.diff(belts, axis=0, append=belts[-1:]),
    )
    mean = np.zeros_like(belts)
    for k in range(ticks):
        at = (k + 0.5) / ticks - 0.5
        mean += np.rint(belts + at * (before if at < 0.0 else after))
    return np.asarray(np.linalg.solve(kinematics.matrix, mean.T * (steps.belt / ticks)).T)


def contour_error(path: Array, nozzle: Array, at: Integers | None = None) -> Array:
    """Return the distance (k,) of the nozzle (p, 2) to the path (p, 2) at samples (k,), or all."""
    return distances(path, nozzle, np.arange(len(path)) if at is None else at)
