"""What a plant makes of a command: sums over its latest samples, and couplings added to axes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hframe_post.arrays import Array, Integers, X, Y
from hframe_post.native import kernels


@dataclass(frozen=True, slots=True)
class Couplings:
    """What filters add to the nozzle, times lever arms.

    axes (c, 3): of the response, of the command, and of the lever arm or -1, where it is 1; centres
    (c,): places where lever arms are 0, mm.
    """

    axes: Integers
    centres: Array

    def lever(self, k: int, place: Array) -> Array | float:
        """Return the lever arm (n,) of a coupling at places (n, 2), mm."""
        along = self.axes[k, 2]
        return 1.0 if along < 0 else np.asarray(place[:, along] - self.centres[k])


def sum_of(outputs: list[Array], couplings: Couplings, place: Array) -> Array:
    """Return what couplings that respond in one axis add at places (n, 2), by outputs (n,)."""
    added = np.zeros(len(place))
    for k, output in enumerate(outputs):
        added += couplings.lever(k, place) * output
    return added


def nozzle(outputs: list[Array], couplings: Couplings, origin: Array, motion: Array) -> Array:
    """Return the nozzle's motion, (n, 2 + m), by the outputs (n,) of all its filters."""
    for axis in (X, Y):
        np.add(outputs[axis], origin[axis], out=motion[:, axis])
    if len(couplings.axes):
        place = motion[:, :2].copy()
        for k, output in enumerate(outputs[2:]):
            motion[:, couplings.axes[k, 0]] += couplings.lever(k, place) * output
    for k, output in enumerate(outputs[2 : motion.shape[1]], 2):
        motion[:, k] = output
    return motion


def finite_filter(
    taps: Array, u: Array, n: int, late: int, rest: float, lag: float
) -> Array:  # fmt: skip
    """Return the output (n,) of a filter at the last n samples of its input u (h,).

    taps (m,): by acceleration, that of the oldest sample first; rest: gain of the input ``late``
    samples before; lag: s⁻¹ of its speed. h is at least n + 1 + the greater of m and ``late``.
    """
    y, room = np.empty(n), np.empty(n + len(taps) - 1)
    kernels.finite_filter(taps, len(taps), u, len(u), n, late, rest, lag, room, y)
    return y


def sliding_sums(factors: Array, u: Array) -> Array:
    """Return the sum of the factors times as many samples of u, from each sample that has them."""
    sums = np.zeros(len(u) + 1 - len(factors))
    kernels.sliding_sums(factors, len(factors), u, len(sums), sums)
    return sums
