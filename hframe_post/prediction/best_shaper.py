"""Good settings of an input shaper within milliseconds, from a quadratic form.

A shaper shifts and averages the path in time, so it commutes with the plant: the nozzle follows the
shaped path as the same average of its shifted motion on the unshaped one. Across the path its
deviation is therefore linear in the impulses a (eq. 1 and 2, with lever arms at x_d, y_d):

    e = A·[a_x; a_y],    mean of e² = [a_x; a_y]ᵀ·Q·[a_x; a_y],    Q = AᵀA/n

Q is computed once for a path; every setting then costs a small product.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from hframe_post.arrays import TS, Array, E, Flags, X, Y, Z
from hframe_post.model.plant import Plant, nozzle
from hframe_post.model.shapers import AxisShaping, Shaper, Shaping, most_damping
from hframe_post.native.linear import one_blas_thread
from hframe_post.prediction.predict import contour_error
from hframe_post.stream.chunks import stretches
from hframe_post.stream.types import Samples

Paths = list[tuple[Array, Flags]]  # each (n, 2), mm, and which samples extrude, (n,)
Candidates = tuple[list[AxisShaping], Array]

STEP = 2  # samples from one impulse to the next
EVERY = 4  # samples from one that counts to the next
REACH = 48  # impulses on either side
HZ = np.geomspace(10.0, 120.0, 16)
DAMPING = np.array([0.0, 0.1, 0.25, 0.5])
MOST_DAMPING = 0.6
REFINED = ((1.08, 0.08), (1.04, 0.04), (1.02, 0.02))  # factors on Hz, and steps of damping


def paths(chunks: Iterable[Samples]) -> Paths:
    """Return the stretches of a stream in which anything is extruded."""
    found = Paths()
    for stretch in stretches(chunks):
        xyze = np.concatenate([chunk.xyze for chunk in stretch])
        counted = np.diff(xyze[:, E], prepend=xyze[:1, E]) > 0.0
        found += [(xyze[:, :Z], counted)] if counted.any() else []
    return found


@one_blas_thread()
def ranked(plant: Plant, paths: Paths, names: Iterable[str]) -> list[Shaping]:
    """Return shapers with good settings for these paths, the most accurate first."""
    Q = quadratic_form(plant, paths)
    return sorted((error(plant, guess(Q, name), paths) for name in names), key=lambda s: s.rms)


def error(plant: Plant, shaping: Shaping, paths: Paths) -> Shaping:
    """Return the shaping with its RMS contour error (mm) on the extruding samples of paths."""
    off, x, y = list[Array](), shaping.x.shaper, shaping.y.shaper
    for path, counted in paths:
        command = np.column_stack([x.run(path[:, X]), y.run(path[:, Y])])
        at = np.flatnonzero(counted)
        off.append(contour_error(path, nozzle(plant, path[0], command), at))
    return replace(shaping, rms=float(np.sqrt(np.square(np.concatenate(off)).mean())))


def quadratic_form(plant: Plant, paths: Paths) -> Array:
    """Return Q, mm², for the impulses of x and then of y, (4·REACH + 2,) squared."""
    Q, count = np.zeros((4 * REACH + 2, 4 * REACH + 2)), 0
    for path, counted in paths:  # all rows at once would take 20 MB
        rows = _across(plant, path, counted)
        Q += rows.T @ rows
        count += len(rows)
    return Q / max(count, 1)


def _across(plant: Plant, path: Array, counted: Flags) -> Array:
    """Return the deviation across the path with each impulse alone, at the samples that count."""
    forward = np.gradient(path, axis=0)
    length = np.hypot(*forward.T)
    at = np.flatnonzero(counted & (length > 0.0))[::EVERY]
    normal = np.column_stack([-forward[:, Y], forward[:, X]])[at] / length[at, None]
    shifted = at[:, None] - STEP * np.arange(-REACH, REACH + 1)
    shifted = np.clip(shifted, 0, len(path) - 1)
    places = nozzle(plant.decoupled(), path[0], path)
    across = [normal[:, k, None] * (places[shifted, k] - path[at, k, None]) for k in (X, Y)]
    if (racking := plant.racking) is not None:
        lever = racking.lever(path[at])[:, None]
        across[X] += normal[:, Y, None] * lever * racking.theta(path[:, X])[shifted]
    return np.hstack(across)


def guess(Q: Array, name: str) -> Shaping:
    """Return frequencies and damping with which that shaper's deviation across the path is least.

    A grid search is refined around its result; ``rms`` is an estimate, mm.
    """
    most = most_damping(name)
    damping = DAMPING[most >= DAMPING].tolist()
    grid = [AxisShaping(name, hz, each) for hz in HZ.tolist() for each in damping]
    known = _usable(grid)
    found = _least(Q, known, known)
    for factor, step in REFINED:
        x, y = (_usable(_around(axis, factor, step)) for axis in (found.x, found.y))
        found = _least(Q, x, y)
    return found


def _around(axis: AxisShaping, factor: float, step: float) -> list[AxisShaping]:
    most = min(MOST_DAMPING, most_damping(axis.name))
    damping = np.clip(axis.damping + step * np.array([-1.0, 0.0, 1.0]), 0.0, most)
    hz = axis.hz * factor ** np.array([-2.0, -1.0, 0.0, 1.0, 2.0])
    return [AxisShaping(axis.name, f, d) for f in hz.tolist() for d in sorted({*damping.tolist()})]


def _usable(axes: list[AxisShaping]) -> Candidates:
    """Return the shapers that are short enough, and their impulses, (k, 2·REACH + 1)."""
    short = [(axis, shaper) for axis in axes if (shaper := axis.shaper).reach < STEP * REACH]
    return [axis for axis, _ in short], np.array([_impulses(shaper) for _, shaper in short])


def _least(Q: Array, x: Candidates, y: Candidates) -> Shaping:
    """Return the best of all pairs."""
    n, (xs, a_x), (ys, a_y) = 2 * REACH + 1, x, y
    squares = 2.0 * a_x @ Q[:n, n:] @ a_y.T
    squares += (a_x @ Q[:n, :n] * a_x).sum(axis=1)[:, None]
    squares += (a_y @ Q[n:, n:] * a_y).sum(axis=1)
    i, j = np.unravel_index(squares.argmin(), squares.shape)
    return Shaping(xs[i], ys[j], float(np.sqrt(max(squares[i, j], 0.0))))


def _impulses(shaper: Shaper) -> Array:
    """Return its impulses interpolated, (2·REACH + 1,)."""
    place = shaper.T / (STEP * TS) + REACH
    impulses = np.zeros(2 * REACH + 1)
    before = np.floor(place).astype(int)
    np.add.at(impulses, before, shaper.A * (1.0 - (place - before)))
    np.add.at(impulses, before + 1, shaper.A * (place - before))
    return impulses
