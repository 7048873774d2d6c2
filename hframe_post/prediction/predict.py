"""Prediction of the nozzle's motion: commands through the plant, compared with the path.

The plant is exact: its states are carried, and racking is that at the actual x (eq. 2), not at
x_d. Where a response begins before its command, chunks wait for the commands that follow. The
contour error is the distance to the path, not to the desired place at that time.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from typing import TypeAlias

import numpy as np

from hframe_post.arrays import TS, Array, E, Flags, Integers, Z
from hframe_post.firmware.motion import MotionRules
from hframe_post.model.kinematics import Kinematics
from hframe_post.model.nozzle import Plants, Responses
from hframe_post.model.plant import Plant
from hframe_post.model.strategies import STRATEGIES
from hframe_post.native.judging import count_turns, deviation, moving, square
from hframe_post.native.stop import NEAREST
from hframe_post.prediction.doubts import Doubts, JudgedDoubts
from hframe_post.prediction.windows import Window
from hframe_post.printer.settings import Steps
from hframe_post.stream.chunks import neighbours, part, stretches, with_neighbours
from hframe_post.stream.marks import Marks
from hframe_post.stream.types import Samples, frozen

COMPENSATING = STRATEGIES.keys() - {"none"}
_Predicted: TypeAlias = tuple[Samples, list[dict[str, Array]]]  # a chunk, and each plant's nozzle


def predict(chunks: Iterable[Samples], plant: Plant) -> Iterator[tuple[Samples, dict[str, Array]]]:
    """Yield each chunk with the nozzle's x, y (n, 2) for every strategy in its commands."""
    for chunk, (motion,) in _predict(chunks, Plants([plant])):
        yield chunk, motion


def _predict(
    chunks: Iterable[Samples], plants: Plants, filament: float | None = None
) -> Iterator[_Predicted]:
    """Yield each chunk with the motion of each plant's nozzle, as ``predict`` gives it for one."""
    for stretch in stretches(chunks):
        nozzles: _Nozzles | None = None
        for chunk in stretch:
            if nozzles is None and len(chunk) and chunk.commands:
                origin, fed = chunk.xyze[0, :Z], chunk.xyze[0, E] if filament is None else filament
                nozzles = _Nozzles(plants.at_rest(origin, len(chunk.commands), float(fed)))
            if nozzles is not None:
                yield from nozzles.feed(chunk)
            else:
                yield chunk, [dict[str, Array]() for _ in range(len(plants))]
        if nozzles is not None:
            yield from nozzles.finish()


class _Nozzles:
    """The chunks of a stretch that wait for their nozzles, which may depend on later commands."""

    def __init__(self, responses: Responses) -> None:
        self._responses, self._early = responses, responses.late
        self._waiting, self._last = deque[Samples](), list[Array]()
        self._motion = np.zeros((0, 0, 0, 2))  # of plants and commands at the waiting samples

    def feed(self, chunk: Samples) -> Iterator[_Predicted]:
        self._waiting.append(chunk)
        if len(chunk):
            self._last = [command[-1:] for command in chunk.commands.values()]
        self._run(list(chunk.commands.values()))
        yield from self._known()

    def finish(self) -> Iterator[_Predicted]:
        """Yield what is left; the commands rest after their end."""
        late = self._responses.late
        self._run([np.repeat(place, late, axis=0) for place in self._last] if late else [])
        yield from self._known()

    def _run(self, commands: list[Array]) -> None:
        if not commands:
            return
        motion = self._responses.run(commands)
        early = min(self._early, motion.shape[2])  # samples before the stretch
        self._early -= early
        motion = motion[:, :, early:]
        waiting = self._motion.shape[2]
        self._motion = np.concatenate([self._motion, motion], axis=2) if waiting else motion

    def _known(self) -> Iterator[_Predicted]:
        while self._waiting and len(self._waiting[0]) <= self._motion.shape[2]:
            chunk = self._waiting.popleft()
            of_chunk, self._motion = np.split(self._motion, [len(chunk)], axis=2)
            motions = [dict(zip(chunk.commands, one, strict=True)) for one in of_chunk]
            yield chunk, motions


@dataclass(frozen=True, slots=True)
class Judgement:
    """How well each strategy follows one chunk, at the k of its samples that count.

    at (k,): indices of these; extruding (k,): which of them extrude. contour: strategy → (k,),
    distance to the path; off: strategy → (k, 2), the way to the nozzle from the nearest place on
    the path. motion: strategy → the nozzle's x, y (n, 2) at all samples. mm.

    Of some of these samples, numbered by doubtful (d,), strategy → ``products`` (d, SUMS) say what
    is not known of the error; without doubts they are empty.
    """

    chunk: Samples
    at: Integers
    extruding: Flags
    contour: dict[str, Array]
    off: dict[str, Array]
    motion: dict[str, Array]
    doubtful: Integers = field(default_factory=lambda: np.zeros(0, np.int64))
    products: dict[str, Array] = field(default_factory=dict)

    def between(self, start: int, stop: int) -> Judgement:
        """Return the judgement of the chunk's samples start … stop − 1."""
        kept = (self.at >= start) & (self.at < stop)
        looked_at = kept[self.doubtful]
        return Judgement(
            part(self.chunk, start, stop), self.at[kept] - start, self.extruding[kept],
            {name: each[kept] for name, each in self.contour.items()},
            {name: each[kept] for name, each in self.off.items()},
            {name: each[start:stop] for name, each in self.motion.items()},
            (np.cumsum(kept) - 1)[self.doubtful[looked_at]],
            {name: each[looked_at] for name, each in self.products.items()},
        )  # fmt: skip

    def tracking(self, strategy: str) -> Array:
        """Return the deviation from the desired place at the same time, (k, 2), mm."""
        return np.asarray(self.motion[strategy][self.at] - self.chunk.xyze[self.at, :Z])


def judge(
    chunks: Iterable[Samples], plant: Plant, every: int = 1, doubts: Doubts | None = None
) -> Iterator[Judgement]:
    """Yield a judgement per chunk, of every n-th sample (n = ``every``) at which the path moves.

    doubts: what is not known of the plant.
    """
    for (judgement,) in judge_each(chunks, Plants([plant]), every, doubts):
        yield judgement


def judge_window(
    window: Window, plants: Plants, every: int = 1, doubts: Doubts | None = None
) -> Judgement:
    """Return the judgement of a window, as ``judge`` gives it for one plant."""
    piece = [replace(window.piece, ends_stretch=True)]
    ((whole,),) = judge_each(piece, plants, every, doubts, window.filament)
    return whole.between(window.start, window.stop)


def judge_each(
    chunks: Iterable[Samples], plants: Plants, every: int = 1, doubts: Doubts | None = None,
    filament: float | None = None,
) -> Iterator[list[Judgement]]:  # fmt: skip
    """Yield the judgements of each chunk, one per plant, as ``judge`` gives them for one.

    doubts: of the first plant. filament: mm on the bed; that of each stretch's first sample by
    default.
    """
    following = max(NEAREST + 1, doubts.ahead if doubts is not None else 0)
    for stretch in stretches(chunks):
        waiting: deque[list[dict[str, Array]]] = deque()
        doubted = None if doubts is None else JudgedDoubts(doubts)
        for before, chunk, after in neighbours(
            _noted(_predict(stretch, plants, filament), waiting), NEAREST, following
        ):
            motions, start = waiting.popleft(), sum(map(len, before))
            xyze = np.concatenate([each.xyze for each in (*before, chunk, *after)])
            first, stop = start + -chunk.first % every, start + len(chunk)
            at, extruding = moving(xyze[:stop], first, every)
            path, judgements = Polyline(xyze), list[Judgement]()
            for motion in motions:
                off = {name: path.deviation(xy, at, start) for name, xy in motion.items()}
                contour = {name: np.sqrt(square(way)) for name, way in off.items()}
                judgements.append(Judgement(chunk, at - start, extruding, contour, off, motion))
            if doubted is not None:
                own = judgements[0]
                which, products = doubted.feed(chunk, after, own.at, own.off)
                judgements[0] = replace(own, doubtful=which, products=products)
            yield judgements


def _noted(
    predicted: Iterable[_Predicted], waiting: deque[list[dict[str, Array]]]
) -> Iterator[Samples]:
    """Yield the chunks; put their motions on ``waiting``."""
    for chunk, motions in predicted:
        waiting.append(motions)
        yield chunk


def as_written(chunk: Samples, rules: MotionRules | None) -> Samples:
    """Return the chunk with the motion that lines make of its commands. None: no lines are made."""
    if rules is None or len(chunk) < 2:
        return chunk
    forced = np.zeros(len(chunk), bool)
    for event in chunk.events:
        at = np.asarray(event.at if isinstance(event, Marks) else [event.index]) - chunk.first
        forced[at[(at >= 0) & (at < len(chunk))]] = True
    return replace(chunk, commands={
        name: frozen(rules.written(np.hstack([command, chunk.xyze[:, Z:]]), forced))
        if name in COMPENSATING else command
        for name, command in chunk.commands.items()
    })  # fmt: skip


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

    def deviation(self, nozzle: Array, at: Integers, first: int = 0) -> Array:
        """Return the shortest way (k, 2) from the path to the nozzle at its samples ``at`` (k,).

        nozzle (n, ≥2): at samples first … first + n − 1, x and y first. The path counts within
        NEAREST samples of each.
        """
        return deviation(self._path, self._turns, nozzle, first, at, NEAREST)
