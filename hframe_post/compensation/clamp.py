"""The clamp: it gives less where a command would leave the bed or outrun a motor.

There a command becomes

    path + share · (command − path)

with a path whose corners are rounded. The share is 1 elsewhere, changes smoothly, and is constant
while the machine dwells, so that the command dwells, too.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from hframe_post.arrays import TS, Array, Z
from hframe_post.model.kinematics import Kinematics
from hframe_post.printer.settings import Motors, Travel
from hframe_post.stream.tally import joined, tallied
from hframe_post.stream.types import Dwell, Samples, frozen

REACHES = (40, 80, 160, 160)  # samples in which a share fades in and out, one after the other
ALL_REMOVED = 2  # of REACHES, from which on nothing is left where a limit is still exceeded
# samples to either side over which corners of the path are rounded: at 5 mm/s, by 7 µm. So belts
# change their speed in as many milliseconds; in 2 of them, a plan for stated motors lets them
ROUNDED = 8
AROUND = 2 * sum(REACHES) + 4 * ROUNDED
SLACK = 1e-9  # mm, or mm/s and mm/s², by which a limit that is met exactly passes
BELOW = 1.0 - 1e-9  # of belts' limits: what is safe must be safe by sums in another order too
MARGIN = 0.9  # share of the admissible compensation that a clamp keeps


@dataclass(frozen=True, slots=True)
class Clamped:
    """Number of samples clamped, source line of the first, and the greatest change (mm)."""

    samples: int = 0
    line: int = tallied(0, lambda one, later: one or later)
    most: float = tallied(0.0, max)


class Clamp:
    """Reduces commands that ask too much. ``clamped``: what was changed so far."""

    def __init__(self, travel: Travel, motors: Motors, kinematics: Kinematics) -> None:
        self._travel, self._kinematics = travel, kinematics
        self._motors = BELOW * motors.belt_velocity, BELOW * motors.belt_acceleration
        self.clamped = Clamped()

    def limited(self, chunk: Samples, wide: Samples, strategy: str) -> Samples:
        """Return a chunk with its command reduced where it asks too much, or itself.

        wide: AROUND samples before it, the chunk, and AROUND samples after it, as far as the
        stretch has them.
        """
        start = chunk.first - wide.first
        own, command = slice(start, start + len(chunk)), wide.commands[strategy]
        safe = self._reduced(wide.xyze[:, :Z], command, _dwells(wide))
        changed = np.abs(safe - command)[own].max(axis=1, initial=0.0) > SLACK
        if not changed.any():
            return chunk
        safe = np.where(changed[:, None], safe[own], command[own])
        line = int(chunk.line[np.argmax(changed)])
        most = float(np.hypot(*(safe - command[own]).T).max())
        self.clamped = joined(self.clamped, Clamped(int(changed.sum()), line, most))
        return replace(chunk, commands={**chunk.commands, strategy: frozen(safe)})

    def _reduced(self, path: Array, command: Array, dwells: list[slice]) -> Array:
        """Return the command (n, 2) with less compensation where a limit is exceeded."""
        travel = self._travel
        edges = (travel.x[0], travel.y[0]), (travel.x[1], travel.y[1])
        path = _rounded(path, dwells)
        safe, share = command, np.ones(len(path))
        for k, reach in enumerate(REACHES):
            left = self._admissible(path, safe)
            if not (exceeded := left < 1.0).any():
                break
            share = np.where(exceeded, 0.0 if k >= ALL_REMOVED else share * left, share)
            share = _smooth(_held(_least(share, reach), dwells, reach), reach)
            safe = np.clip(path + share[:, None] * (command - path), *edges)
        return safe

    def _admissible(self, path: Array, command: Array) -> Array:
        """Return the share of the compensation that bed and belts allow at each sample, (n,)."""
        share, belts = np.ones(len(path)), self._kinematics.belts
        for axis, (low, high) in enumerate((self._travel.x, self._travel.y)):
            bed = _share_within(path[:, axis], command[:, axis], low, high, 1.0)
            share = np.minimum(share, bed)
        for order, limit in enumerate(self._motors, 1):
            of_path, of_command = (
                np.diff(belts(*xy.T), n=order) / TS**order for xy in (path, command)
            )
            for one, other in zip(of_path, of_command, strict=True):
                within = _share_within(one, other, -limit, limit, MARGIN)
                share[order:] = np.minimum(share[order:], within)
        return share


def _dwells(chunk: Samples) -> list[slice]:
    """Return the samples at which the machine dwells."""
    dwells = list[slice]()
    for event in chunk.events:
        if isinstance(event, Dwell):
            at = event.index - chunk.first
            dwells.append(slice(max(at - 1, 0), max(at + event.samples, 0)))
    return dwells


def _least(share: Array, reach: int) -> Array:
    """Return the least share (n,) of samples −reach … reach around each."""
    longer = np.pad(share, reach, mode="edge")
    return np.asarray(sliding_window_view(longer, 2 * reach + 1).min(axis=1))


def _held(share: Array, dwells: list[slice], reach: int) -> Array:
    """Return shares (n,), no greater, that are constant from ``reach`` before to after dwells."""
    share, low = share.copy(), True
    around = [share[max(dwell.start - reach, 0) : dwell.stop + reach] for dwell in dwells]
    while low:  # dwells that are close to each other share theirs
        low = False
        for each in around:
            if (least := each.min(initial=1.0)) < each.max(initial=least):
                each[:], low = least, True
    return share


def _rounded(path: Array, dwells: list[slice]) -> Array:
    """Return the path (n, 2) with rounded corners, and the same dwells and ends."""
    moving = np.ones(len(path))
    for at in (slice(1), *dwells, slice(-1, None)):
        moving[at] = 0.0
    share = _smooth(_least(moving, ROUNDED), ROUNDED)
    return np.asarray(path + share[:, None] * (_smooth(path, ROUNDED) - path))


def _smooth(values: Array, reach: int) -> Array:
    """Return weighted means (n, …) of samples −reach … reach around each, without corners."""
    ramp = 0.5 + 0.5 * np.cos(np.pi * np.arange(-reach, reach + 1) / (reach + 1))
    weights = ramp.round(12)  # the last digit of a cosine depends on the processor
    n, edges = len(values), [(reach, reach)] + [(0, 0)] * (values.ndim - 1)
    longer, total = np.pad(values, edges, mode="edge"), np.zeros_like(values)
    for k, weight in enumerate(weights.tolist()):  # added up alike wherever samples begin
        total += weight * (longer[k : k + n] - values)
    return np.asarray(values + total / weights.sum())


def _share_within(path: Array, command: Array, low: float, high: float, margin: float) -> Array:
    """Return the share of command − path (n,) that stays within bounds; times margin if not all."""
    over = (command < low - SLACK) | (command > high + SLACK)
    bound = np.clip(command, low, high)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = (bound - path) / (command - path)
    return np.where(over, np.clip(margin * share, 0.0, 1.0), 1.0)
