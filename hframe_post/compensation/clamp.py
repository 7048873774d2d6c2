"""The clamp: it reduces the compensation where a command would leave the bed or outrun a motor.

The reduction is smooth and only where needed, until the belts can follow; at the edge of the bed
the command is cut off. Where the belts cannot follow the reduction itself, all of the compensation
is removed over a longer time.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from hframe_post.arrays import TS, Array, Z
from hframe_post.compensation.guard import SLACK
from hframe_post.model.kinematics import Kinematics
from hframe_post.native import kernel
from hframe_post.printer.settings import Motors, Travel
from hframe_post.stream.chunks import join, neighbours, stretches
from hframe_post.stream.types import Samples, frozen

REACH = 80  # samples over which a clamp fades in and out
LONGER_REACHES = (2 * REACH, 4 * REACH)  # tried where the belts cannot follow that
AROUND = REACH + sum(LONGER_REACHES) + 6  # samples to either side that a clamp depends on
MARGIN = 0.9  # share of the admissible compensation that a clamp keeps


@dataclass(frozen=True, slots=True)
class Clamped:
    """Number of samples clamped, source line of the first, and the greatest change (mm)."""

    samples: int = 0
    line: int = 0
    most: float = 0.0

    def joined(self, later: Clamped) -> Clamped:
        return Clamped(
            self.samples + later.samples, self.line or later.line, max(self.most, later.most)
        )


class Clamp:
    """Reduces commands that ask too much. ``clamped``: what was changed so far."""

    def __init__(self, travel: Travel, motors: Motors, kinematics: Kinematics) -> None:
        self._travel, self._motors, self._kinematics = travel, motors, kinematics
        # a little lower, since what is safe here must be safe by sums in another order too
        belts = ((1.0 - 1e-9) * v for v in (motors.belt_velocity, motors.belt_acceleration))
        self._limits = np.array([-np.inf, np.inf, *travel.x, *travel.y, *belts])
        self.clamped = Clamped()

    def limit(self, chunks: Iterable[Samples], strategy: str) -> Iterator[Samples]:
        """Yield the chunks with the command of ``strategy`` reduced where it asks too much."""
        for stretch in stretches(chunks):
            for before, chunk, after in neighbours(stretch, AROUND, AROUND):
                around = [*before, chunk, *after]
                if self._all_safe(around, strategy):
                    yield chunk
                    continue
                wide, start = join(around), sum(map(len, before))
                command, where = wide.commands[strategy], slice(start, start + len(chunk))
                safe = self._reduced(wide.xyze[:, :Z], command)
                changed = np.abs(safe - command)[where].max(axis=1, initial=0.0) > SLACK
                safe = np.where(changed[:, None], safe[where], chunk.commands[strategy])
                if changed.any():
                    line = int(chunk.line[np.argmax(changed)])
                    most = float(np.hypot(*(safe - chunk.commands[strategy]).T).max())
                    self.clamped = self.clamped.joined(Clamped(int(changed.sum()), line, most))
                yield replace(chunk, commands={**chunk.commands, strategy: frozen(safe)})

    def _all_safe(self, chunks: list[Samples], strategy: str) -> bool:
        """Return whether the compiled loop finds nothing to reduce in successive chunks."""
        if (compiled := kernel("safe")) is None:
            return False
        belts, peaks, before = self._kinematics.matrix, np.zeros(4), None
        for chunk in filter(len, chunks):
            command = np.ascontiguousarray(chunk.commands[strategy])
            if before is None:  # no change of speed at the first samples
                before = command[:1] - np.outer([2.0, 1.0], command[:2][-1] - command[0])
            motion = chunk.xyze, command, len(command), before
            if not compiled(*motion, self._limits, belts, TS, peaks):
                return False
        return True

    def _reduced(self, path: Array, command: Array) -> Array:
        """Return the command (n, 2) as bed and belts allow it, the belts if at all possible."""
        travel = self._travel
        edges = (travel.x[0], travel.y[0]), (travel.x[1], travel.y[1])
        share = _faded(self._admissible(path, command), REACH)
        for reach in LONGER_REACHES:
            safe = np.clip(path + share[:, None] * (command - path), *edges)
            if (share == 1.0).all():
                return safe
            exceeded = self._admissible(path, safe) < 1.0
            if not exceeded.any():
                return safe
            share = np.minimum(share, _faded(np.where(exceeded, 0.0, 1.0), reach))
        return np.clip(path + share[:, None] * (command - path), *edges)

    def _admissible(self, path: Array, command: Array) -> Array:
        """Return the share of the compensation that bed and belts allow at each sample, (n,)."""
        share, motors, belts = np.ones(len(path)), self._motors, self._kinematics.belts
        for axis, (low, high) in enumerate((self._travel.x, self._travel.y)):
            bed = _share_within(path[:, axis], command[:, axis], low, high, 1.0)
            share = np.minimum(share, bed)
        for order, limit in ((1, motors.belt_velocity), (2, motors.belt_acceleration)):
            path_rate = np.diff(belts(*path.T), n=order) / TS**order
            command_rate = np.diff(belts(*command.T), n=order) / TS**order
            for of_path, of_command in zip(path_rate, command_rate, strict=True):
                belt = _share_within(of_path, of_command, -limit, limit, MARGIN)
                share[order:] = np.minimum(share[order:], belt)
        return share


def _faded(needed: Array, reach: int) -> Array:
    """Return a smooth share (n,) that is nowhere above ``needed`` and fades over ``reach``."""
    share = np.ones(len(needed))
    ramp = 0.5 + 0.5 * np.cos(np.pi * np.arange(-reach, reach + 1) / (reach + 1))
    ramp = ramp.round(12)  # the last digit of a cosine depends on the processor
    for k in np.flatnonzero(needed < 1.0).tolist():  # few: only where a limit is exceeded
        low, high = max(k - reach, 0), min(k + reach + 1, len(share))
        removed = (1.0 - needed[k]) * ramp[low - k + reach : high - k + reach]
        share[low:high] = np.minimum(share[low:high], 1.0 - removed)
    return share


def _share_within(path: Array, command: Array, low: float, high: float, margin: float) -> Array:
    """Return the share of command − path (n,) that stays within bounds; times margin if not all."""
    over = (command < low - SLACK) | (command > high + SLACK)
    bound = np.clip(command, low, high)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = (bound - path) / (command - path)
    return np.where(over, np.clip(margin * share, 0.0, 1.0), 1.0)
