"""Random motions."""

from __future__ import annotations

import numpy as np

from hframe_post.arrays import Array, Flags


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
