"""Prediction of the nozzle's motion: commands through the plant, compared with the path.

A stream is judged window by window. Each brings the samples before and after it on which its own
depend, so that it is as exact as the whole. Racking is that at the actual x (eq. 2), not at x_d.
The contour error is the distance to the path, not to the desired place at that time.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from hframe_post.arrays import TS, Array, Flags, Integers, Z
from hframe_post.model.kinematics import Kinematics
from hframe_post.model.plant import Nozzle, Plant
from hframe_post.model.strategies import STRATEGIES
from hframe_post.native.judging import count_turns, deviation, moving, play, square
from hframe_post.native.stop import NEAREST
from hframe_post.prediction.doubts import Doubts
from hframe_post.prediction.windows import Window, Windows, around
from hframe_post.printer.settings import Steps
from hframe_post.stream.chunks import part, stretches, with_neighbours
from hframe_post.stream.types import Samples, frozen

COMPENSATING = STRATEGIES.keys() - {"none"}


SHOWN_EVERY = 4  # samples of windows that are only shown; ringing at 50 Hz takes 20


@dataclass(frozen=True, slots=True)
class Judgement:
    """How well each strategy follows the samples of a window, at the k of them that count.

    weight: of how many windows it is an example; 0: it is only shown. every: samples from one that
    counts to the next, while the path moves. at (k,): their indices; extruding (k,): which of them
    extrude. contour: strategy → (k,), distance to the path; off: strategy → (k, 2), the way to the
    nozzle from the nearest place on the path. motion: strategy → the nozzle's x, y (n, 2) at all
    samples, or ``apart`` from ``begin`` on. mm.

    Of some of these samples, numbered by doubtful (d,), strategy → ``products`` (d, SUMS) say what
    is not known of the error; without doubts they are empty.
    """

    chunk: Samples
    weight: int
    every: int
    at: Integers
    extruding: Flags
    contour: dict[str, Array]
    off: dict[str, Array]
    motion: dict[str, Array]
    begin: int
    apart: int
    doubtful: Integers
    products: dict[str, Array]

    def nozzle(self, strategy: str, at: Integers) -> Array:
        """Return the nozzle's x, y (k, 2) at samples (k,) of those that count."""
        return self.motion[strategy].take((at - self.begin) // self.apart, axis=0)

    def tracking(self, strategy: str) -> Array:
        """Return the deviation from the desired place at the same time, (k, 2), mm."""
        return np.asarray(self.nozzle(strategy, self.at) - self.chunk.xyze[self.at, :Z])


class Judge:
    """Judges windows of commands on a plant, at every n-th sample (n = ``every``) of the print.

    doubts: what is not known of the plant. before, after: samples that a window needs around it.
    """

    def __init__(self, plant: Plant, every: int = 1, doubts: Doubts | None = None) -> None:
        self._plant, self._every, self._doubts = plant, every, doubts
        self._load, self._nozzle = 0, Nozzle(plant.loaded(0))
        self.before = max(self._nozzle.past, NEAREST, doubts.past if doubts else 0)
        self.after = max(self._nozzle.ahead, NEAREST + 1, doubts.ahead if doubts else 0)

    def judged(self, window: Window) -> Judgement:
        """Return the judgement of a window."""
        piece, start, stop = window.piece, window.start, window.stop
        own, path, nozzle = part(piece, start, stop), Polyline(piece.xyze), self._at(window)
        every, apart = (self._every, 1) if window.weight else (SHOWN_EVERY, SHOWN_EVERY)
        first, begin = (start + -own.first % each for each in (every, apart))
        at, extruding = moving(piece.xyze[:stop], first, every)
        motion = {
            name: nozzle.at(
                around(u, begin - nozzle.past, stop + nozzle.ahead), stop - begin, apart
            )
            for name, u in piece.commands.items()
            if stop > begin
        }
        off = {name: path.deviation(xy, at, begin, apart) for name, xy in motion.items()}
        contour = {name: np.sqrt(square(way)) for name, way in off.items()}
        which, products = np.zeros(0, np.int64), dict[str, Array]()
        if self._doubts is not None and window.weight:
            which, products = self._doubts.along(window, at, off)
        at, begin = at - start, begin - start
        known = extruding, contour, off, motion
        return Judgement(own, window.weight, every, at, *known, begin, apart, which, products)

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


def with_path(chunk: Samples) -> Samples:
    """Return the chunk with the path itself as the command without compensation."""
    return replace(chunk, commands={"none": chunk.xyze[:, :Z], **chunk.commands})


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
        while self._segments and self._segments[0][0][-1] < piece.first:
            self._segments.popleft()
        if self.strategy not in piece.commands:
            return piece
        command = piece.commands[self.strategy].copy()
        for ends, at in self._segments:
            play(ends, at, piece.first, command)
        return replace(piece, commands={**piece.commands, self.strategy: frozen(command)})


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
    at = np.arange(len(path)) if at is None else at
    return np.sqrt(square(Polyline(path).deviation(nozzle, at)))


class Polyline:
    """The path through the desired samples (p, ≥2), x and y first."""

    def __init__(self, path: Array) -> None:
        self._path = np.ascontiguousarray(path)
        self._turns = count_turns(self._path)

    def deviation(self, nozzle: Array, at: Integers, first: int = 0, apart: int = 1) -> Array:
        """Return the shortest way (k, 2) from the path to the nozzle at its samples ``at`` (k,).

        nozzle (n, ≥2): at samples first, first + apart, …, x and y first. The path counts within
        NEAREST samples of each.
        """
        return deviation(self._path, self._turns, nozzle, first, apart, at, NEAREST)
