"""No command leaves the bed or outruns a motor: an error, or a clamp that is reported.

Clamping takes the compensation back, smoothly and only around the place, until the belts
can follow; at the edge of the bed the command is cut off. Where the belts cannot follow the taking
back itself, all of it is taken, over a longer time.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from hframe_post.arrays import TS, Array, Z
from hframe_post.errors import HframeError, LimitError
from hframe_post.model.kinematics import Differences, Kinematics, Rates
from hframe_post.printer.settings import Motors, Travel
from hframe_post.stream.chunks import stretches, with_neighbours
from hframe_post.stream.types import Samples, frozen

REACH = 80  # samples over which a clamp sets in and fades out
WIDER = (2 * REACH, 4 * REACH)  # where belts cannot follow that
SEEN = REACH + sum(WIDER) + 6  # samples to either side that decide; the belts' differences see two
TAKE_MORE = 0.9  # share of the excess-free compensation that a clamp leaves
LEEWAY = 1.0 + 1e-9  # limits met exactly are met
SLACK = 1e-9  # mm, to the same end
FAULT = "line {line}: the command computed here {what}; nothing was written. Please report this"


@dataclass(frozen=True, slots=True)
class Peaks:
    """The most that the commands asked of the machine: mm/s, mm/s²; axis_acceleration: x, y."""

    belt_velocity: float = 0.0
    belt_acceleration: float = 0.0
    axis_acceleration: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Clamped:
    """Samples taken back, the source line of the first of them, and the most of any (mm)."""

    samples: int = 0
    line: int = 0
    most: float = 0.0

    def joined(self, later: Clamped) -> Clamped:
        """Both."""
        return Clamped(
            self.samples + later.samples, self.line or later.line, max(self.most, later.most)
        )


class Guard:
    """Lets commands pass once they are known to be safe. ``peaks``: of what has passed.

    clamped: whether all that could be taken back has been.
    """

    def __init__(
        self, travel: Travel, motors: Motors, kinematics: Kinematics, clamped: bool = False
    ) -> None:
        self._travel, self._motors, self._kinematics = travel, motors, kinematics
        self._clamped = clamped
        self.peaks = Peaks()

    def check(self, chunks: Iterable[Samples], strategy: str) -> Iterator[Samples]:
        """The stream as it is. Raises LimitError for a command of ``strategy`` that is not safe.

        HframeError for a stream that is not sound: the last look at it before it is written.
        """
        end: int | None = None  # of the last chunk; every span begins at 0
        for stretch in stretches(chunks):
            differences = Differences(self._kinematics)
            for chunk in stretch:
                command = chunk.commands[strategy]
                _check_sound(chunk, command, end)
                end = chunk.end
                if len(chunk):
                    _check_travel(chunk, command, self._travel)
                    rates = differences.of(command)
                    _check_motors(chunk, rates, self._motors, self._clamped)
                    self._note(rates)
                yield chunk

    def _note(self, rates: Rates) -> None:
        x, y = (_greatest(axis) for axis in rates.axis_acceleration)
        known = self.peaks
        self.peaks = Peaks(
            max(known.belt_velocity, _greatest(rates.belt_velocity)),
            max(known.belt_acceleration, _greatest(rates.belt_acceleration)),
            (max(known.axis_acceleration[0], x), max(known.axis_acceleration[1], y)),
        )


class Clamp:
    """Takes commands back where they ask too much. ``clamped``: what was, so far."""

    def __init__(self, travel: Travel, motors: Motors, kinematics: Kinematics) -> None:
        self._travel, self._motors, self._kinematics = travel, motors, kinematics
        self.clamped = Clamped()

    def limit(self, chunks: Iterable[Samples], strategy: str) -> Iterator[Samples]:
        """The stream with the command of ``strategy`` taken back where it asks too much."""
        travel = self._travel
        for stretch in stretches(chunks):
            for chunk, wide, where in with_neighbours(stretch, SEEN, SEEN):
                path, command = wide.xyze[:, :Z], wide.commands[strategy]
                safe = _taken_back(path, command, travel, self._motors, self._kinematics)
                changed = (safe != command).any(axis=1)[where]
                safe = np.where(changed[:, None], safe[where], chunk.commands[strategy])
                if changed.any():
                    line = int(chunk.line[np.argmax(changed)])
                    most = float(np.hypot(*(safe - chunk.commands[strategy]).T).max())
                    self.clamped = self.clamped.joined(Clamped(int(changed.sum()), line, most))
                yield replace(chunk, commands={**chunk.commands, strategy: frozen(safe)})


def _greatest(values: Array) -> float:
    """The greatest magnitude."""
    return max(float(values.max()), -float(values.min()))


def _taken_back(
    path: Array, command: Array, travel: Travel, motors: Motors, kinematics: Kinematics
) -> Array:
    """The command (n, 2) as bed and belts allow it, the belts if at all possible."""
    share = _faded(_needed(path, command, travel, motors, kinematics), REACH)
    edges = (travel.x[0], travel.y[0]), (travel.x[1], travel.y[1])
    for wider in (*WIDER, None):
        safe = np.clip(path + share[:, None] * (command - path), *edges)
        if wider is None or (share == 1.0).all():
            break
        exceeded = _needed(path, safe, travel, motors, kinematics) < 1.0
        if not exceeded.any():
            break
        share = np.minimum(share, _faded(np.where(exceeded, 0.0, 1.0), wider))
    return safe


def _needed(
    path: Array, command: Array, travel: Travel, motors: Motors, kinematics: Kinematics
) -> Array:
    """Share of the compensation that bed and belts allow at each sample, (n,)."""
    needed = np.ones(len(path))
    for axis, (low, high) in enumerate((travel.x, travel.y)):
        of_path, of_command = path[:, axis], command[:, axis]
        needed = np.minimum(needed, _allowed(of_path, of_command, low, high, 1.0))
    for order, limit in ((1, motors.belt_velocity), (2, motors.belt_acceleration)):
        path_rate = np.diff(kinematics.belts(*path.T), n=order) / TS**order
        command_rate = np.diff(kinematics.belts(*command.T), n=order) / TS**order
        for belt in (0, 1):
            allowed = _allowed(path_rate[belt], command_rate[belt], -limit, limit, TAKE_MORE)
            needed[order:] = np.minimum(needed[order:], allowed)
    return needed


def _faded(needed: Array, over: int) -> Array:
    """A smooth share (n,), no more than is needed, that fades ``over`` so many samples."""
    share = np.ones(len(needed))
    ramp = 0.5 + 0.5 * np.cos(np.pi * np.arange(-over, over + 1) / (over + 1))
    for k in np.flatnonzero(needed < 1.0).tolist():  # few: the places where a limit is exceeded
        low, high = max(k - over, 0), min(k + over + 1, len(share))
        taken = (1.0 - needed[k]) * ramp[low - k + over : high - k + over]
        share[low:high] = np.minimum(share[low:high], 1.0 - taken)
    return share


def _allowed(path: Array, command: Array, low: float, high: float, margin: float) -> Array:
    """Share of command − path (n,) that stays within low … high, times a margin if not all."""
    over = (command < low - SLACK) | (command > high + SLACK)
    bound = np.clip(command, low, high)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = (bound - path) / (command - path)
    return np.where(over, np.clip(margin * share, 0.0, 1.0), 1.0)


def _check_sound(chunk: Samples, command: Array, first: int | None) -> None:
    """Raises HframeError unless time goes on and all numbers are numbers."""
    line = int(chunk.line[0]) if len(chunk) else 0
    places = [chunk.first, *(event.index for event in chunk.events), chunk.end]
    if (first is not None and chunk.first != first) or places != sorted(places):
        raise HframeError(FAULT.format(line=line, what="goes back in time"))
    if not (np.isfinite(command).all() and np.isfinite(chunk.xyze).all()):
        finite = np.isfinite(command).all(axis=1) & np.isfinite(chunk.xyze).all(axis=1)
        line = int(chunk.line[np.argmin(finite)])
        raise HframeError(FAULT.format(line=line, what="is not a number"))


def _check_travel(chunk: Samples, command: Array, travel: Travel) -> None:
    z = chunk.xyze[:, Z]
    if z.min() < travel.z[0] - SLACK or z.max() > travel.z[1] + SLACK:
        k = int(np.argmax((z < travel.z[0] - SLACK) | (z > travel.z[1] + SLACK)))
        low, high = travel.z
        bound = low if z[k] < low else high
        advice = "see travel.z of the profile"
        raise LimitError("z (mm)", float(z[k]), bound, int(chunk.line[k]), advice)
    for axis, (low, high) in enumerate((travel.x, travel.y)):
        position = command[:, axis]
        if position.min() >= low - SLACK and position.max() <= high + SLACK:
            continue
        for k, bound in ((int(position.argmin()), low), (int(position.argmax()), high)):
            if position[k] < low - SLACK or position[k] > high + SLACK:
                off = abs(position[k] - chunk.xyze[k, axis])
                raise LimitError(
                    f"{'xy'[axis]} (mm)", float(position[k]), bound, int(chunk.line[k]),
                    f"the compensation adds {off:.3g} mm here: move the part inwards, "
                    "widen [travel] in the profile if the bed allows it, or use --on-limit clamp",
                )  # fmt: skip


def _check_motors(chunk: Samples, rates: Rates, motors: Motors, clamped: bool) -> None:
    for order, name, asked, limit in (
        (1, "velocity", rates.belt_velocity, motors.belt_velocity),
        (2, "acceleration", rates.belt_acceleration, motors.belt_acceleration),
    ):
        if _greatest(asked) > limit * LEEWAY:
            magnitude = np.abs(asked).max(axis=0)
            k = int(magnitude.argmax())
            raise LimitError(
                f"belt {name} (mm/s{'²' * (order - 1)})", float(magnitude[k]), limit,
                int(chunk.line[k]),
                "raise effort in [compensation], lower the print's speed or acceleration, "
                f"raise motors.belt_{name} if the motors can do it"
                + ("; clamping was not enough" if clamped else ", or use --on-limit clamp"),
            )  # fmt: skip
