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
