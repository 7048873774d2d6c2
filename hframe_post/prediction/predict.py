"""Prediction of the nozzle's motion: commands through the plant, compared with the path.

The plant is exact: its states are carried, and racking is that at the actual x (eq. 2), not at
x_d. The contour error is the distance to the path, not to the desired place at that time.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from hframe_post.arrays import TS, Array, Flags, Integers, X, Y, Z
from hframe_post.model.kinematics import Kinematics
from hframe_post.model.plant import Plant, Response
from hframe_post.model.stop_cost import NEAREST
from hframe_post.native import kernel
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
    distance to the path; off: strategy → (k, 2), the way to the nozzle from the nearest place on
    the path. motion: strategy → the nozzle's x, y (n, 2) at all samples. mm.
    """

    chunk: Samples
    at: Integers
    extruding: Flags
    contour: dict[str, Array]
    off: dict[str, Array]
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
            off = {
                name: deviation(path, xy[first::every], where.start + here)[moving]
                for name, xy in motion.items()
            }
            contour = {name: np.sqrt(_square(way)) for name, way in off.items()}
            yield Judgement(chunk, here[moving], extruding[moving], contour, off, motion)


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


COARSE = 3  # samples from one candidate to the next in the first search
STRAIGHT = 1e-6  # sine of an angle below which a path goes straight on


def contour_error(path: Array, actual: Array, at: Integers) -> Array:
    """Return the distance (n,) of the points ``actual`` (n, 2) to the path: see ``deviation``."""
    return np.sqrt(_square(deviation(path, actual, at)))


def deviation(path: Array, actual: Array, at: Integers) -> Array:
    """Return the shortest way (n, 2) from the path to each of the points ``actual`` (n, 2).

    path (p, 2): the desired samples; at (n,): which of them belongs to each point. The path
    is the polyline through its samples within NEAREST of that. Where this is a straight line,
    the distance is that to the line; elsewhere the nearest sample is found first, then the
    nearer of the two segments that meet there.
    """
    px, py = np.ascontiguousarray(path[:, X]), np.ascontiguousarray(path[:, Y])
    ax, ay = np.ascontiguousarray(actual[:, X]), np.ascontiguousarray(actual[:, Y])
    n, p = len(ax), len(px)
    if (compiled := kernel("deviation")) is not None:
        off, room = np.empty((n, 2)), np.empty(p + 1, np.int64)
        compiled(px, py, p, ax, ay, at, n, NEAREST, COARSE, STRAIGHT, off, room)
        return off
    low, high = np.maximum(at - NEAREST, 0), np.minimum(at + NEAREST, p - 1)
    turns = np.concatenate([[0], np.cumsum(_turns(px, py))])
    off = _from_segment(ax, ay, px[low], py[low], px[high], py[high])
    bent = np.flatnonzero(turns[high] != turns[low + 1])  # a turn strictly between
    ax, ay, at = ax[bent], ay[bent], at[bent]
    coarse = _nearest(px, py, ax, ay, [at + k for k in range(-NEAREST, NEAREST + 1, COARSE)])
    # next what was left out: around the result, and around the sample of the same time, which is
    # right at sharp corners if the nozzle follows well
    k = _nearest(px, py, ax, ay, [coarse - 1, coarse, coarse + 1, at - 1, at, at + 1])
    k = np.clip(k, 0, p - 1)
    before, after = np.maximum(k - 1, 0), np.minimum(k + 1, p - 1)
    x, y = px[k], py[k]
    one = _from_segment(ax, ay, x, y, px[before], py[before])
    other = _from_segment(ax, ay, x, y, px[after], py[after])
    nearer = _square(one) < _square(other)
    off[bent] = np.where(nearer[:, None], one, other)
    return off


def _turns(px: Array, py: Array) -> Flags:
    """Return at which of its p samples the path changes its direction."""
    dx, dy = np.diff(px), np.diff(py)
    cross, dot = dx[:-1] * dy[1:] - dy[:-1] * dx[1:], dx[:-1] * dx[1:] + dy[:-1] * dy[1:]
    still = (dx == 0.0) & (dy == 0.0)
    turning = (np.abs(cross) > STRAIGHT * np.abs(dot)) | (dot < 0.0)
    turns = np.ones(len(px), dtype=bool)
    turns[1:-1] = turning | (still[:-1] != still[1:])
    return turns


def _nearest(px: Array, py: Array, ax: Array, ay: Array, candidates: list[Integers]) -> Integers:
    """Return which of the candidate samples, (q,) each, is nearest to each of the points a (q,)."""
    nearest, best = candidates[0], np.full(len(ax), np.inf)
    for candidate in candidates:
        k = np.clip(candidate, 0, len(px) - 1)
        dx, dy = px[k] - ax, py[k] - ay
        distance2 = dx * dx + dy * dy
        nearest = np.where(distance2 < best, candidate, nearest)
        np.minimum(best, distance2, out=best)
    return nearest


def _square(off: Array) -> Array:
    return np.asarray(off[:, X] * off[:, X] + off[:, Y] * off[:, Y])


def _from_segment(ax: Array, ay: Array, px: Array, py: Array, qx: Array, qy: Array) -> Array:
    """Return the shortest way (q, 2) to points a from the segments between p and q, all (q,)."""
    dx, dy, ax, ay = qx - px, qy - py, ax - px, ay - py
    length2 = dx * dx + dy * dy
    share = np.divide(ax * dx + ay * dy, length2, out=np.zeros(len(ax)), where=length2 > 0.0)
    np.minimum(np.maximum(share, 0.0, out=share), 1.0, out=share)
    dx *= share
    dy *= share
    ax -= dx
    ay -= dy
    return np.column_stack([ax, ay])
