"""Prediction of the nozzle's motion: commands through the plant, compared with the path.

The plant is exact: its states are carried, and racking is that at the actual x (eq. 2), not at
x_d. The contour error is the distance to the path, not to the desired place at that time.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from hframe_post.arrays import TS, Array, Flags, Integers, Z
from hframe_post.model.kinematics import Kinematics
from hframe_post.model.plant import Plant, Response
from hframe_post.model.stop_cost import NEAREST
from hframe_post.prediction.contour import contour_error
from hframe_post.printer.settings import Steps
from hframe_post.stream.chunks import stretches, with_neighbours
from hframe_post.stream.types import Samples, frozen


def predict(chunks: Iterable[Samples], plant: Plant) -> Iterator[tuple[Samples, dict[str, Array]]]:
    """Yield each chunk with the nozzle's x, y (n, 2) for every strategy in its commands."""
    for stretch in stretches(chunks):
        responses: dict[str, Response] = {}
        for chunk in stretch:
            if len(chunk) and not responses:
                responses = {name: Response(plant, chunk.xyze[0, :Z]) for name in chunk.commands}
            yield chunk, {name: r.run(chunk.commands[name]) for name, r in responses.items()}


@dataclass(frozen=True, slots=True)
class Judgement:
    """How well each strategy follows one chunk, at the k of its samples that count.

    at (k,): indices of these; extruding (k,): which of them extrude. contour: strategy → (k,),
    distance to the path. motion: strategy → the nozzle's x, y (n, 2) at all samples. mm.
    """

    chunk: Samples
    at: Integers
    extruding: Flags
    contour: dict[str, Array]
    motion: dict[str, Array]

    def tracking(self, strategy: str) -> Array:
        """Return the deviation from the desired place at the same time, (k, 2), mm."""
        return np.asarray(self.motion[strategy][self.at] - self.chunk.xyze[self.at, :Z])


def judge(chunks: Iterable[Samples], plant: Plant, every: int = 1) -> Iterator[Judgement]:
    """Yield a judgement per chunk, of every n-th sample (n = ``every``) at which the path moves."""
    for stretch in stretches(chunks):
        predicted: deque[tuple[Samples, dict[str, Array]]] = deque()
        paths = _paths(predict(stretch, plant), predicted)
        for _, wide, where in with_neighbours(paths, NEAREST, NEAREST + 1):
            chunk, motion = predicted.popleft()
            first = -chunk.first % every
            moving, extruding = (flags[where][first::every] for flags in in_motion(wide.xyze))
            here, path = np.arange(first, len(chunk), every), wide.xyze[:, :Z]
            contour = {
                name: contour_error(path, xy[first::every], where.start + here)[moving]
                for name, xy in motion.items()
            }
            yield Judgement(chunk, here[moving], extruding[moving], contour, motion)


def _paths(
    predicted: Iterable[tuple[Samples, dict[str, Array]]],
    taken: deque[tuple[Samples, dict[str, Array]]],
) -> Iterator[Samples]:
    """Yield the path alone of each chunk; put the chunk with its motion on ``taken``."""
    for chunk, motion in predicted:
        taken.append((chunk, motion))
        yield replace(chunk, events=(), commands={})


def in_motion(xyze: Array) -> tuple[Flags, Flags]:
    """Return at which samples the path xyze (n, 4) moves, and at which it extrudes too, (n,)."""
    moving, extruding = np.zeros((2, len(xyze)), dtype=bool)
    x, y, _, e = xyze.T
    moving[1:] = (x[1:] != x[:-1]) | (y[1:] != y[:-1])
    extruding[1:] = moving[1:] & (e[1:] > e[:-1])
    return moving, extruding


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
