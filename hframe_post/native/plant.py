"""Filters of a plant: one, those of couplings, and the nozzle's response.

A transfer function is a cascade of second-order sections (k, 6) with a state (k, 2), as for
``scipy.signal.sosfilt``. Several are ``Sections``, in one block of memory. A filter waits for its
last output at each sample; so in C four plants, or the responses to four commands, take little
longer than one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hframe_post.arrays import Array, Integers, X, Y
from hframe_post.native import kernels

LANES = 4  # responses that are computed together; C refuses any other number


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


@dataclass(frozen=True, slots=True)
class Sections:
    """Sections (k, 6) and state (k, 2) of filters in turn; counts: how many sections each has."""

    table: Array
    state: Array
    counts: Integers

    def each(self) -> list[tuple[Array, Array]]:
        """Return sections and state of each filter, as parts of these."""
        cuts = np.cumsum(self.counts)[:-1]
        return list(zip(np.split(self.table, cuts), np.split(self.state, cuts), strict=True))


def filtered(sections: Array, state: Array, u: Array) -> Array:
    """Return the output (n,) of a transfer function at the next samples of the input u (n,)."""
    u, y = np.ascontiguousarray(u), np.empty(len(u))
    kernels.filtered(sections, len(sections), state, u, len(u), y)
    return y


def coupled(
    filters: Sections, couplings: Couplings, origin: Array, path: Array,
    commands: tuple[Array, Array],
) -> Array:  # fmt: skip
    """Return what couplings that respond in one axis add there, (n,).

    filters: those of the couplings. commands: in x and in y, (n,); path (n, 2): tells the lever
    arms. Both are relative to the origin (2,).
    """
    added, path = np.zeros(len(path)), np.ascontiguousarray(path)
    u, v = map(np.ascontiguousarray, commands)
    kernels.coupled(*_arguments(filters, couplings), origin, path, u, v, len(path), added)
    return added


def sum_of(outputs: list[Array], couplings: Couplings, place: Array) -> Array:
    """Return what couplings that respond in one axis add at places (n, 2), by outputs (n,)."""
    added = np.zeros(len(place))
    for k, output in enumerate(outputs):
        added += couplings.lever(k, place) * output
    return added


def response(
    filters: Sections, couplings: Couplings, origin: Array, command: Array, motion: Array
) -> Array:
    """Return the nozzle's motion under a command (n, 2) from rest at origin (2,).

    filters: Gxx, Gyy and those of the couplings. motion (n, 2 + m): takes x, y of the nozzle and
    the outputs of the first m couplings' filters.
    """
    n, columns = motion.shape
    command = np.ascontiguousarray(command)
    kernels.response(*_arguments(filters, couplings), origin, command, n, motion, columns)
    return motion


def nozzle(outputs: list[Array], couplings: Couplings, origin: Array, motion: Array) -> Array:
    """Return the nozzle's motion, as ``response``, by the outputs (n,) of all its filters."""
    for axis in (X, Y):
        np.add(outputs[axis], origin[axis], out=motion[:, axis])
    if len(couplings.axes):
        place = motion[:, :2].copy()
        for k, output in enumerate(outputs[2:]):
            motion[:, couplings.axes[k, 0]] += couplings.lever(k, place) * output
    for k, output in enumerate(outputs[2 : motion.shape[1]], 2):
        motion[:, k] = output
    return motion


def responses(
    filters: Sections, couplings: Couplings, origin: Array, commands: Array, which: Integers
) -> Array:
    """Return the nozzle's motions (lanes, n, 2), each of which ``response`` gives for a lane.

    Lanes come in groups of LANES, the last of which may be filled up: table (groups, k, 6, LANES),
    state (groups, k, 2, LANES), centres (groups, c, LANES). commands (m, n, 2); which (lanes,): the
    command of each lane.
    """
    lanes, (given, n, _) = len(which), commands.shape
    motion = np.empty((lanes, n, 2))
    counts, axes = filters.counts, couplings.axes
    kernels.responses(
        filters.table, filters.table.shape[1], filters.state, counts, len(counts), axes,
        couplings.centres, len(axes), origin, commands, given, which, n, lanes, LANES, motion,
    )  # fmt: skip
    return motion


def _arguments(
    filters: Sections, couplings: Couplings
) -> tuple[Array, int, Array, Integers, int, Integers, Array, int]:
    axes = couplings.axes
    counted = filters.table, len(filters.table), filters.state, filters.counts, len(filters.counts)
    return *counted, axes, couplings.centres, len(axes)


def sliding_sums(factors: Array, u: Array) -> Array:
    """Return the sum of the factors times as many samples of u, from each sample that has them."""
    sums = np.zeros(len(u) + 1 - len(factors))
    kernels.sliding_sums(factors, len(factors), u, len(sums), sums)
    return sums
