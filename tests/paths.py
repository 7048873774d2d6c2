"""Motions: random ones, strokes with rest around them, and streams in smaller chunks."""

from collections.abc import Iterable, Iterator

import numpy as np

from hframe_post.arrays import TS, Array, Flags
from hframe_post.stream.chunks import part
from hframe_post.stream.types import Samples

ORIGIN = np.array([100.0, 120.0])  # of strokes, mm


def wander(seed: int, n: int, power: float) -> tuple[Array, Flags]:
    """n + 1 points of a random motion, and some that must stay."""
    rng = np.random.default_rng(seed)
    velocity = rng.normal(0.0, 0.1, 4) + np.cumsum(rng.normal(0.0, 10.0**power, (n, 4)), axis=0)
    points = np.concatenate([np.zeros((1, 4)), np.cumsum(velocity, axis=0)])
    return points, rng.random(n + 1) < rng.choice([0.0, 0.05, 0.5])


def walk(rng: np.random.Generator, n: int) -> Array:
    """Return a path (n, 2) of straight lines with some corners, curves and standstill."""
    velocity = np.repeat(rng.normal(0.0, 0.1, (n // 20 + 1, 2)), 20, axis=0)[:n]
    velocity += rng.normal(0.0, 0.01, (n, 2)) * (rng.random((n, 1)) < rng.choice([0.0, 0.1, 1.0]))
    velocity[: int(rng.integers(0, n))] *= rng.choice([0.0, 1.0])
    return np.cumsum(velocity, axis=0)


def stroke(length: float, speed: float, rest: int, acceleration: float = 5000.0) -> Array:
    """Return positions (n,) of one trapezoidal move with rest around it."""
    ramp = np.arange(0.0, speed + 1e-9, acceleration * TS)
    cruise = np.full(int(length / speed / TS), speed)
    moving = np.cumsum(np.concatenate([ramp, cruise, ramp[::-1]])) * TS
    return np.concatenate([np.zeros(rest), moving, np.full(rest, moving[-1])])


def strokes() -> Array:
    """Return diagonal strokes of 30 mm and back, one of them in x alone, (n, 2)."""
    x, y = (stroke(30.0, speed, 600) for speed in (100.0, 150.0))
    n = max(len(x), len(y))
    x, y = (np.pad(each, (0, n - len(each)), mode="edge") for each in (x, y))
    back = np.column_stack([np.concatenate([x, x[::-1]]), np.concatenate([y, np.full(n, y[-1])])])
    return np.asarray(ORIGIN + back)


def in_motion(xyze: Array) -> tuple[Flags, Flags]:
    """Return at which samples the path xyze (n, 4) moves, and at which it extrudes too, (n,)."""
    moves, extruding = np.zeros((2, len(xyze)), dtype=bool)
    x, y, _, e = xyze.T
    moves[1:] = (x[1:] != x[:-1]) | (y[1:] != y[:-1])
    extruding[1:] = moves[1:] & (e[1:] > e[:-1])
    return moves, extruding


def smaller(chunks: Iterable[Samples], n: int) -> Iterator[Samples]:
    for chunk in chunks:
        for start in range(0, len(chunk), n):
            yield part(chunk, start, min(start + n, len(chunk)))
        if not len(chunk):
            yield chunk
