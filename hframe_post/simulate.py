"""Predicts where the nozzle goes: commands through the plant, and how far off the path.

The plant is exact: states carried, and racking at the actual x (eq. 2), not at x_d. The
contour error is the distance to the path, not to where the nozzle should be at that time.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator

import numpy as np

from hframe_post.arrays import Array, Flags
from hframe_post.plant import LiftedFilter, Plant
from hframe_post.recut import stretches, with_neighbours
from hframe_post.stream import Pause, Rest, Samples, X, Y, Z, frozen

NEAREST = 24  # samples to either side in which the path's nearest point is sought


class Response:
    """The nozzle's motion under one strategy's command, streamed."""

    def __init__(self, plant: Plant, origin: Array) -> None:
        self._origin, self._x_c = origin, plant.x_c
        self._Gxx, self._Gyy = LiftedFilter(plant.Gxx), LiftedFilter(plant.Gyy)
        self._Gxtheta = LiftedFilter(plant.Gxtheta) if plant.Gxtheta else None

    def run(self, command: Array) -> Array:
        """Nozzle x, y (n, 2) under the next commands (n, 2): eq. 1 and 2."""
        u = command - self._origin
        x = self._Gxx.run(u[:, X]) + self._origin[X]
        y = self._Gyy.run(u[:, Y]) + self._origin[Y]
        if self._Gxtheta is not None:
            y += (x - self._x_c) * self._Gxtheta.run(u[:, X])
        return np.column_stack([x, y])


def predict(blocks: Iterable[Samples], plant: Plant) -> Iterator[tuple[Samples, dict[str, Array]]]:
    """Each block and, for every strategy in its commands, the nozzle's x, y (n, 2)."""
    for stretch in stretches(blocks):
        responses: dict[str, Response] = {}
        for block in stretch:
            if len(block) and not responses:
                responses = {name: Response(plant, block.xyze[0, :Z]) for name in block.commands}
            yield block, {name: r.run(block.commands[name]) for name, r in responses.items()}


def contour_errors(
    blocks: Iterable[Samples], plant: Plant
) -> Iterator[tuple[Samples, dict[str, Array]]]:
    """Each block and, for every strategy, the contour error of its samples in motion, mm.

    Samples at which the machine rests for something else are left out: nothing of the path
    is traced there.
    """
    for stretch in stretches(blocks):
        originals: deque[Samples] = deque()
        predicted = _predicted(stretch, plant, originals)
        for block, wide, where in with_neighbours(predicted, NEAREST, NEAREST + 1):
            moving, path = in_motion(block), wide.xyze[:, :Z]
            yield originals.popleft(), {
                name: contour_error(path, actual, where.start)[moving]
                for name, actual in block.commands.items()
            }


def _predicted(
    blocks: Iterable[Samples], plant: Plant, originals: deque[Samples]
) -> Iterator[Samples]:
    """The blocks with motion in place of commands; those with commands are remembered."""
    for block, actual in predict(blocks, plant):
        originals.append(block)
        motion = {name: frozen(xy) for name, xy in actual.items()}
        yield Samples(block.first, block.xyze, block.line, block.events, motion)


def in_motion(block: Samples) -> Flags:
    """Samples that are not part of a rest or pause, (n,)."""
    moving = np.ones(len(block), dtype=bool)
    for event in block.events:
        if isinstance(event, Rest | Pause):
            start = event.index - block.first
            moving[start : start + event.samples] = False
    return moving


def contour_error(path: Array, actual: Array, start: int) -> Array:
    """Distance (n,) of ``actual`` (n, 2) to the path (p, 2) whose sample ``start`` is its first.

    The path is the polyline through its samples within NEAREST of each: first the nearest
    sample is found, then the nearer of the two segments that meet there.
    """
    n, p = len(actual), len(path)
    if not n:
        return np.zeros(0)
    middle = path[start]
    near = np.pad((path - middle).astype(np.float32), ((NEAREST, NEAREST), (0, 0)), mode="edge")
    here = (actual - middle).astype(np.float32)
    px, py = np.ascontiguousarray(near[:, 0]), np.ascontiguousarray(near[:, 1])
    ax, ay = np.ascontiguousarray(here[:, 0]), np.ascontiguousarray(here[:, 1])
    best = np.full(n, np.inf, dtype=np.float32)
    nearest = np.zeros(n, dtype=np.int16)
    for shift in range(2 * NEAREST + 1):
        at = slice(start + shift, start + shift + n)
        dx, dy = ax - px[at], ay - py[at]
        distance2 = dx * dx + dy * dy
        closer = distance2 < best
        np.copyto(nearest, shift, where=closer)
        np.minimum(best, distance2, out=best)
    k = np.clip(np.arange(start - NEAREST, start - NEAREST + n) + nearest, 0, p - 1)
    left = _to_segment(path, np.maximum(k - 1, 0), k, actual)
    return np.minimum(left, _to_segment(path, k, np.minimum(k + 1, p - 1), actual))


def _to_segment(path: Array, i: Array, j: Array, point: Array) -> Array:
    """Distance (n,) of points (n, 2) to the segments path[i]–path[j]."""
    along, to = path[j] - path[i], point - path[i]
    length2 = (along * along).sum(axis=1)
    share = np.divide((to * along).sum(axis=1), length2, out=np.zeros(len(to)), where=length2 > 0)
    off = to - np.clip(share, 0.0, 1.0)[:, None] * along
    return np.sqrt((off * off).sum(axis=1))
