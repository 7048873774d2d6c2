"""No command leaves the bed or outruns a motor: an error, or a clamp that is reported.

Clamping takes the compensation back, smoothly and only around the place, until the belts
can follow; at the edge of the bed the command is cut off.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

import numpy as np

from hframe_post.arrays import TS, Array, Z
from hframe_post.errors import LimitError
from hframe_post.model.kinematics import Kinematics
from hframe_post.printer.settings import Motors, Travel
from hframe_post.stream.chunks import stretches, with_neighbours
from hframe_post.stream.types import Samples, frozen

REACH = 80  # samples over which a clamp sets in and fades out
TAKE_MORE = 0.9  # share of the excess-free compensation that a clamp leaves
LEEWAY = 1.0 + 1e-9  # limits met exactly are met
SLACK = 1e-9  # mm, to the same end


@dataclass
class Peaks:
    """What the commands asked of the machine; mm, s."""

    belt_velocity: float = 0.0
    belt_acceleration: float = 0.0
    axis_acceleration: Array = field(default_factory=lambda: np.zeros(2))
    clamped: int = 0  # samples
    clamped_line: int = 0  # source line of the first of them


def guard(
    blocks: Iterable[Samples],
    written: str,
    travel: Travel,
    motors: Motors,
    kinematics: Kinematics,
    peaks: Peaks,
) -> Iterator[Samples]:
    """The stream as it is, once its ``written`` command is known to be safe.

    Fills ``peaks`` as it flows. Raises LimitError.
    """
    for stretch in stretches(blocks):
        before = np.zeros((0, 2))  # the last two commands
        for block in stretch:
            if len(block):
                command = np.concatenate([before, block.commands[written]])
                _check_travel(block, block.commands[written], travel)
                belts = kinematics.belts(*command.T)
                _check_motors(block, belts, len(before), motors, peaks)
                _note_axes(command, peaks)
                before = command[-2:]
            yield block


def clamp(
    blocks: Iterable[Samples],
    written: str,
    travel: Travel,
    motors: Motors,
    kinematics: Kinematics,
    peaks: Peaks,
) -> Iterator[Samples]:
    """The stream with its ``written`` command taken back where it asks too much."""
    for stretch in stretches(blocks):
        for block, wide, where in with_neighbours(stretch, REACH + 2, REACH + 2):
            path, command = wide.xyze[:, :Z], wide.commands[written]
            share = _share(path, command, travel, motors, kinematics)
            safe = path + share[:, None] * (command - path)
            safe = np.clip(safe, (travel.x[0], travel.y[0]), (travel.x[1], travel.y[1]))
            changed = (safe != command).any(axis=1)[where]
            safe = np.where(changed[:, None], safe[where], block.commands[written])
            if changed.any():
                peaks.clamped_line = peaks.clamped_line or int(block.line[np.argmax(changed)])
                peaks.clamped += int(changed.sum())
            commands = {**block.commands, written: frozen(safe)}
            yield Samples(block.first, block.xyze, block.line, block.events, commands)


def _share(
    path: Array, command: Array, travel: Travel, motors: Motors, kinematics: Kinematics
) -> Array:
    """Share of the compensation that bed and belts allow, (n,), smooth over REACH samples."""
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
    share = np.ones(len(path))
    ramp = 0.5 + 0.5 * np.cos(np.pi * np.arange(-REACH, REACH + 1) / (REACH + 1))
    for k in np.flatnonzero(needed < 1.0).tolist():  # few: the places where a limit is exceeded
        low, high = max(k - REACH, 0), min(k + REACH + 1, len(share))
        taken = (1.0 - needed[k]) * ramp[low - k + REACH : high - k + REACH]
        share[low:high] = np.minimum(share[low:high], 1.0 - taken)
    return share


def _allowed(path: Array, command: Array, low: float, high: float, margin: float) -> Array:
    """Share of command − path (n,) that stays within low … high, times a margin if not all."""
    over = (command < low - SLACK) | (command > high + SLACK)
    bound = np.clip(command, low, high)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = (bound - path) / (command - path)
    return np.where(over, np.clip(margin * share, 0.0, 1.0), 1.0)


def _check_travel(block: Samples, command: Array, travel: Travel) -> None:
    for axis, (low, high) in enumerate((travel.x, travel.y)):
        position = command[:, axis]
        for k, bound in ((int(position.argmin()), low), (int(position.argmax()), high)):
            if position[k] < low - SLACK or position[k] > high + SLACK:
                off = abs(position[k] - block.xyze[k, axis])
                raise LimitError(
                    f"{'xy'[axis]} (mm)", float(position[k]), bound, int(block.line[k]),
                    f"the compensation adds {off:.3g} mm here: move the part inwards, "
                    "widen [travel] in the profile if the bed allows it, or use --on-limit clamp",
                )  # fmt: skip


def _note_axes(command: Array, peaks: Peaks) -> None:
    for axis, position in enumerate(command.T):
        peak = _greatest(np.diff(position, n=2)) / TS**2
        peaks.axis_acceleration[axis] = max(peaks.axis_acceleration[axis], peak)


def _check_motors(block: Samples, belts: Array, known: int, motors: Motors, peaks: Peaks) -> None:
    """Speed and acceleration of a block's belts (2, n), ``known`` ones before it in front."""
    for order, name, limit in (
        (1, "velocity", motors.belt_velocity),
        (2, "acceleration", motors.belt_acceleration),
    ):
        for belt in belts:
            value = np.diff(belt, n=order)
            peak = _greatest(value) / TS**order
            setattr(peaks, f"belt_{name}", max(getattr(peaks, f"belt_{name}"), peak))
            if peak > limit * LEEWAY:
                k = max(int(np.abs(value).argmax()) + order - known, 0)
                raise LimitError(
                    f"belt {name} (mm/s{'²' * (order - 1)})", peak, limit, int(block.line[k]),
                    "raise effort in [compensation], lower the print's speed or acceleration, "
                    f"raise motors.belt_{name} if the motors can do it, or use --on-limit clamp",
                )  # fmt: skip


def _greatest(values: Array) -> float:
    """Greatest magnitude."""
    return float(max(values.max(initial=0.0), -values.min(initial=0.0)))
