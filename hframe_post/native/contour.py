"""The way from a path to the nozzle."""

from __future__ import annotations

import numpy as np

from hframe_post.arrays import Array, Flags, Integers, X, Y
from hframe_post.native import kernels

COARSE = 3  # samples from one candidate to the next in the first search
STRAIGHT = 1e-6  # sine of an angle below which a path goes straight on


def count_turns(path: Array) -> Integers:
    """Return how many samples of a path (p, ≥2) before each change its direction, (p + 1,)."""
    turns = np.zeros(len(path) + 1, np.int64)
    kernels.count_turns(path, path.shape[1], len(path), STRAIGHT, turns)
    return turns


def deviation(
    path: Array, turns: Integers, nozzle: Array, first: int, at: Integers, reach: int
) -> Array:
    """Return the shortest way (k, 2) from a path (p, ≥2) to the nozzle at its samples ``at`` (k,).

    turns: see ``count_turns``; nozzle (n, ≥2): at samples first … first + n − 1. x and y come
    first. The path counts within ``reach`` samples of each. Where it is a straight line, the
    distance is that to the line; elsewhere the nearest sample is found first, then the nearer of
    the two segments that meet there.
    """
    p = len(path)
    nozzle, off = np.ascontiguousarray(nozzle), np.empty((len(at), 2))
    of_path, of_nozzle = (path, path.shape[1], p, turns), (nozzle, nozzle.shape[1], len(nozzle))
    kernels.deviation(*of_path, *of_nozzle, first, at, len(at), reach, COARSE, off)
    return off


def square(off: Array) -> Array:
    """Return the squares (q,) of lengths of ways (q, 2)."""
    return np.asarray(off[:, X] * off[:, X] + off[:, Y] * off[:, Y])


def moving(xyze: Array, first: int, every: int) -> tuple[Integers, Flags]:
    """Return which of every n-th sample from ``first`` on move, and which of them extrude, (k,)."""
    at, extruding = np.empty(len(xyze), np.int64), np.empty(len(xyze), bool)
    count = kernels.moving(xyze, len(xyze), first, every, at, extruding)
    return at[:count], extruding[:count]
