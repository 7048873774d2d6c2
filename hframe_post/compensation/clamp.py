"""The clamp: it gives less where a command would leave the bed or outrun a motor.

Near the edge of the bed, and where the belts would be too fast, the compensation is reduced; at the
edge itself the command is cut off. Where the belts would accelerate too hard, as they do in the
first milliseconds of a corner, the command is averaged over a longer and longer time. Both begin
and end smoothly, and a command that must dwell does so.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from hframe_post.arrays import TS, Array, Flags, Z
from hframe_post.compensation.guard import SLACK
from hframe_post.model.kinematics import Kinematics
from hframe_post.native.judging import is_safe
from hframe_post.printer.settings import Motors, Travel
from hframe_post.stream.chunks import join, neighbours, stretches
from hframe_post.stream.tally import joined, tallied
from hframe_post.stream.types import Dwell, Samples, frozen

REACH = 80  # samples over which a reduction fades in and out
LONGER_REACHES = (2 * REACH, 4 * REACH)  # where that itself would be too fast: all is removed
# Samples to either side that the command is averaged over, one after the other where the belts
# still cannot follow; and over which that fades in and out. A corner at 20 mm/s that is averaged
# over 33 ms is cut by 0.1 mm; what needs more is a path that the motors cannot follow
AVERAGED, FADE = (1, 2, 4, 8, 16), 40
NEAR_DWELL = 5  # samples of fading where a command must dwell and nothing else was enough
AROUND = REACH + 2 * sum(LONGER_REACHES) + 2 * (sum(AVERAGED) + (len(AVERAGED) + 2) * (FADE + 2))
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
                if not len(chunk) or self._all_safe(around, strategy):
                    yield chunk
                    continue
                wide, start = join(around), sum(map(len, before))
                command, where = wide.commands[strategy], slice(start, start + len(chunk))
                path = wide.xyze[:, :Z]
                safe = self._averaged(self._reduced(path, command), _dwelling(wide))
                safe = self._removed(path, safe)
                safe = self._averaged(safe, _dwelling(wide), NEAR_DWELL)
                changed = np.abs(safe - command)[where].max(axis=1, initial=0.0) > SLACK
                safe = np.where(changed[:, None], safe[where], chunk.commands[strategy])
                if changed.any():
                    line = int(chunk.line[np.argmax(changed)])
                    most = float(np.hypot(*(safe - chunk.commands[strategy]).T).max())
                    self.clamped = joined(self.clamped, Clamped(int(changed.sum()), line, most))
                yield replace(chunk, commands={**chunk.commands, strategy: frozen(safe)})

    def _all_safe(self, chunks: list[Samples], strategy: str) -> bool:
        """Return whether there is nothing to reduce in successive chunks."""
        belts, peaks, before = self._kinematics.matrix, np.zeros(4), None
        for chunk in filter(len, chunks):
            command = chunk.commands[strategy]
            if before is None:  # no change of speed at the first samples
                before = command[:1] - np.outer([2.0, 1.0], command[:2][-1] - command[0])
            if not is_safe(chunk.xyze, command, before, self._limits, belts, peaks):
                return False
        return True

    def _reduced(self, path: Array, command: Array) -> Array:
        """Return the command (n, 2) with less compensation at the bed's edge and at full speed."""
        travel = self._travel
        edges = (travel.x[0], travel.y[0]), (travel.x[1], travel.y[1])

        def with_share(share: Array) -> Array:
            return np.clip(path + share[:, None] * (command - path), *edges)

        share = _faded(self._admissible(path, command), REACH)
        for reach in LONGER_REACHES:
            exceeded = self._admissible(path, with_share(share)) < 1.0
            if not exceeded.any():
                break
            share = np.minimum(share, _faded(np.where(exceeded, 0.0, 1.0), reach))
        return with_share(share)

    def _admissible(self, path: Array, command: Array) -> Array:
        """Return the share of the compensation that bed and speed allow at each sample, (n,)."""
        share, limit, belts = np.ones(len(path)), self._motors.belt_velocity, self._kinematics.belts
        for axis, (low, high) in enumerate((self._travel.x, self._travel.y)):
            bed = _share_within(path[:, axis], command[:, axis], low, high, 1.0)
            share = np.minimum(share, bed)
        of_path, of_command = (np.diff(belts(*xy.T)) / TS for xy in (path, command))
        for pair in zip(of_path, of_command, strict=True):
            share[1:] = np.minimum(share[1:], _share_within(*pair, -limit, limit, MARGIN))
        return share

    def _averaged(self, command: Array, dwelling: Flags, fade: int = FADE) -> Array:
        """Return the command (n, 2) averaged where the belts would accelerate too hard.

        dwelling (n,): samples that must stay, from which the averaging fades in over ``fade``
        samples. Means of places on the bed are on it, too.
        """
        free = 1.0 - _near(dwelling, fade)
        for reach in AVERAGED:
            hard = self._too_hard(command)
            if not hard.any():
                break
            share = free * _near(hard)
            command = command + share[:, None] * (_mean(command, reach) - command)
        return command

    def _removed(self, path: Array, command: Array) -> Array:
        """Return the command (n, 2) without compensation where the belts still are too hard.

        That is next to samples at which the machine dwells, which are not averaged.
        """
        for reach in LONGER_REACHES:
            hard = self._too_hard(command)
            if not hard.any():
                break
            share = _faded(np.where(hard, 0.0, 1.0), reach)
            command = path + share[:, None] * (command - path)
        return command

    def _too_hard(self, command: Array) -> Flags:
        """Flag the samples (n,) at which a belt accelerates harder than it may."""
        belts = self._kinematics.belts(*command.T)
        hard = np.zeros(len(command), dtype=bool)
        hard[2:] = (np.abs(np.diff(belts, n=2)) > self._limits[-1] * TS**2).any(axis=0)
        return hard


def _dwelling(chunk: Samples) -> Flags:
    """Return at which samples (n,) the machine dwells, also at the ends of a stretch."""
    dwelling = np.zeros(len(chunk), dtype=bool)
    dwelling[[0, -1]] = True
    for event in chunk.events:
        if isinstance(event, Dwell):
            at = event.index - chunk.first
            dwelling[max(at - 1, 0) : max(at + event.samples, 0)] = True
    return dwelling


def _near(flags: Flags, fade: int = FADE) -> Array:
    """Return a smooth share (n,), 1 where flagged and 0 from ``fade`` samples away on."""
    at, k = np.flatnonzero(flags), np.arange(len(flags))
    if not len(at):
        return np.zeros(len(flags))
    following = np.searchsorted(at, k)
    after = at[np.minimum(following, len(at) - 1)]
    away = np.minimum(np.abs(after - k), np.abs(k - at[np.maximum(following - 1, 0)]))
    return np.where(away > fade, 0.0, _ramp(fade)[fade + np.minimum(away, fade)])


def _mean(command: Array, reach: int) -> Array:
    """Return the mean (n, 2) of samples −reach … reach around each."""
    n = len(command)
    longer = np.concatenate([command[:1].repeat(reach, 0), command, command[-1:].repeat(reach, 0)])
    total = np.zeros_like(command)
    for k in range(2 * reach + 1):  # not as a difference of sums, which depend on where they begin
        total += longer[k : k + n] - command
    return command + total / (2 * reach + 1)


def _faded(needed: Array, reach: int) -> Array:
    """Return a smooth share (n,) that is nowhere above ``needed`` and fades over ``reach``."""
    share, ramp = np.ones(len(needed)), _ramp(reach)
    for k in np.flatnonzero(needed < 1.0).tolist():  # few: only where a limit is exceeded
        low, high = max(k - reach, 0), min(k + reach + 1, len(share))
        removed = (1.0 - needed[k]) * ramp[low - k + reach : high - k + reach]
        share[low:high] = np.minimum(share[low:high], 1.0 - removed)
    return share


def _ramp(reach: int) -> Array:
    """Return a smooth rise to 1 and fall, (2·reach + 1,)."""
    ramp = 0.5 + 0.5 * np.cos(np.pi * np.arange(-reach, reach + 1) / (reach + 1))
    return np.asarray(ramp.round(12))  # the last digit of a cosine depends on the processor


def _share_within(path: Array, command: Array, low: float, high: float, margin: float) -> Array:
    """Return the share of command − path (n,) that stays within bounds; times margin if not all."""
    over = (command < low - SLACK) | (command > high + SLACK)
    bound = np.clip(command, low, high)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = (bound - path) / (command - path)
    return np.where(over, np.clip(margin * share, 0.0, 1.0), 1.0)
