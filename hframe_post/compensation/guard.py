"""Checks of the model and of the commands before anything is written, and the clamp.

No command may leave the bed, outrun a motor, or ask for more than a real printer can need: each is
an error. A clamp may instead reduce the compensation, smoothly and only where needed, until the
belts can follow; at the edge of the bed it cuts the command off. Where the belts cannot follow the
reduction itself, it removes all of the compensation over a longer time.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import chain, product

import numpy as np

from hframe_post.arrays import TS, Array, E, X, Y, Z
from hframe_post.errors import HframeError, LimitError, PrinterError
from hframe_post.model.kinematics import Differences, Kinematics, Rates
from hframe_post.model.plant import Plant
from hframe_post.model.rounds import contraction
from hframe_post.native import kernel
from hframe_post.printer.settings import Limits, Motors, Printer, Travel
from hframe_post.stream.chunks import join, neighbours, stretches
from hframe_post.stream.types import Samples, frozen

REACH = 80  # samples over which a clamp fades in and out
LONGER_REACHES = (2 * REACH, 4 * REACH)  # tried where the belts cannot follow that
AROUND = REACH + sum(LONGER_REACHES) + 6  # samples to either side that a clamp depends on
MARGIN = 0.9  # share of the admissible compensation that a clamp keeps
LEEWAY, SLACK = 1.0 + 1e-9, 1e-9  # factor and mm by which a limit that is met exactly passes
SLOW_HZ = 3.0  # frequency at which lag and stiffness are read off a model
ADVICE = (
    "the [plant] of this profile does not describe this printer: run `hframe-post sweep` and "
    "`hframe-post identify` again"
)


# ---------------------------------------------------------------------- the model


def check_model(printer: Printer) -> None:
    """Raise PrinterError if x and y would act on each other more than in any printer."""
    travel, windows = printer.travel, printer.compensation.windows
    for place in (*product(travel.x, travel.y), (sum(travel.x) / 2.0, sum(travel.y) / 2.0)):
        if not contraction(printer.plant, windows, np.array(place)) < 1.0:
            raise PrinterError(
                f"at x = {place[X]:g}, y = {place[Y]:g} the couplings of this model are so strong "
                f"that no command cancels them; remove them, or {ADVICE}",
                "plant.cross", printer.name,
            )  # fmt: skip
    G, limits = printer.plant.Gxtheta, printer.limits
    if G is None:
        return
    omega = 2.0 * np.pi * SLOW_HZ
    slow = abs(complex(G.response(np.array([omega * TS]))[0]))
    angle = min(slow / omega * limits.velocity, slow / omega**2 * limits.acceleration)
    if angle > 0.02:  # rad
        raise PrinterError(
            f"this model twists the gantry by {1e3 * angle:.0f} mrad, more than any printer; "
            f"{ADVICE}",
            "plant.Gxtheta", printer.name,
        )  # fmt: skip


def max_deviation(plant: Plant, limits: Limits) -> float:
    """Return how far a command may be from its path, in mm.

    A command leads the path by what the nozzle lags behind: speed times lag, and acceleration over
    the square of the printer's frequency. Twice that, and 3 mm, are allowed.
    """
    omega = 2.0 * np.pi * SLOW_HZ
    lead = 0.0
    for G in (plant.Gxx, plant.Gyy):
        response = complex(G.response(np.array([omega * TS]))[0])
        lag, compliance = -response.imag / omega, abs(1.0 - response.real) / omega**2
        lead = max(lead, abs(lag) * limits.velocity + compliance * limits.acceleration)
    return 3.0 + 2.0 * lead


def check_deviation(
    chunks: Iterable[Samples], strategy: str, plant: Plant, limits: Limits
) -> Iterator[Samples]:
    """Yield the chunks. Raise HframeError if a command is over ``max_deviation`` off its path."""
    load, most = 0, max_deviation(plant, limits)
    for chunk in chunks:
        if len(chunk):
            if load != (now := plant.load(float(chunk.xyze[0, E]))):
                load, most = now, max_deviation(plant.loaded(now), limits)
            command = chunk.commands[strategy]
            k = _farthest(chunk.xyze, command)
            off = float(np.hypot(*(command[k] - chunk.xyze[k, :Z])))
            if not off <= most:
                raise HframeError(
                    f"line {int(chunk.line[k])}: the compensation would move the nozzle "
                    f"{off:.1f} mm off its path; the lag of the model explains at "
                    f"most {most:.1f} mm. Probably {ADVICE}"
                )
        yield chunk


def _farthest(xyze: Array, command: Array) -> int:
    """Return the sample whose command is farthest from the path, or one without a number."""
    if (compiled := kernel("farthest")) is not None:
        return compiled(xyze, np.ascontiguousarray(command), len(command))
    dx, dy = (command[:, axis] - xyze[:, axis] for axis in (X, Y))
    return int((dx * dx + dy * dy).argmax())


def check_prediction(rms: float) -> None:
    """Raise HframeError if this RMS error (mm) without compensation is beyond any printer."""
    if rms > 1.0:
        raise HframeError(
            f"the model predicts {rms:.1f} mm RMS of contour error without compensation, more than "
            f"any working printer has. Probably {ADVICE}"
        )


# ---------------------------------------------------------------------- the guard


@dataclass(frozen=True, slots=True)
class Peaks:
    """Greatest rates of the commands, mm/s and mm/s²; axis_acceleration: x, y."""

    belt_velocity: float = 0.0
    belt_acceleration: float = 0.0
    axis_acceleration: tuple[float, float] = (0.0, 0.0)


class Guard:
    """Passes commands that are safe. ``peaks``: rates of what has passed so far.

    clamped: whether a clamp has already reduced the compensation, which error messages mention.
    """

    def __init__(
        self, travel: Travel, motors: Motors, kinematics: Kinematics, clamped: bool = False
    ) -> None:
        self._travel, self._motors, self._kinematics = travel, motors, kinematics
        self._clamped = clamped
        axes = ((low - SLACK, high + SLACK) for low, high in (travel.z, travel.x, travel.y))
        belts = motors.belt_velocity * LEEWAY, motors.belt_acceleration * LEEWAY
        self._limits = np.array([*chain(*axes), *belts])
        self._peaks = np.zeros(4)

    @property
    def peaks(self) -> Peaks:
        """Return the greatest rates so far."""
        velocity, acceleration, x, y = self._peaks.tolist()
        return Peaks(velocity, acceleration, (x, y))

    def check(self, chunks: Iterable[Samples], strategy: str) -> Iterator[Samples]:
        """Yield the chunks. Raise LimitError for an unsafe command, HframeError for a bug."""
        end: int | None = None  # of the last chunk; every span begins at 0
        for stretch in stretches(chunks):
            differences = Differences(self._kinematics)
            for chunk in stretch:
                command = chunk.commands[strategy]
                _check_order(chunk, end)
                leaps = chunk.ends_stretch  # samples may be left out after it
                end = None if leaps else chunk.end
                if len(chunk) and not self._safe(chunk, command, differences):
                    _check_finite(chunk, command)
                    _check_travel(chunk, command, self._travel)
                    rates = differences.rates(command)
                    _check_motors(chunk, rates, self._motors, self._clamped)
                    here = rates.belt_velocity, rates.belt_acceleration, *rates.axis_acceleration
                    self._peaks = np.maximum(self._peaks, [_greatest(rate) for rate in here])
                yield chunk

    def _safe(self, chunk: Samples, command: Array, differences: Differences) -> bool:
        """Return whether the compiled loop finds the command safe; then note its rates."""
        if (compiled := kernel("safe")) is None:
            return False
        command, before = np.ascontiguousarray(command), differences.before(command)
        limits, belts = self._limits, self._kinematics.matrix
        return bool(
            compiled(chunk.xyze, command, len(command), before, limits, belts, TS, self._peaks)
        )


def _greatest(values: Array) -> float:
    return max(float(values.max()), -float(values.min()))


FAULT = "line {}: the command computed here {}; nothing was written. Please report this bug"


def _check_order(chunk: Samples, first: int | None) -> None:
    places = [chunk.first, *(event.index for event in chunk.events), chunk.end]
    if (first is not None and chunk.first != first) or places != sorted(places):
        line = int(chunk.line[0]) if len(chunk) else 0
        raise HframeError(FAULT.format(line, "goes back in time"))


def _check_finite(chunk: Samples, command: Array) -> None:
    finite = np.isfinite(command).all(axis=1) & np.isfinite(chunk.xyze).all(axis=1)
    if not finite.all():
        raise HframeError(FAULT.format(int(chunk.line[np.argmin(finite)]), "is not a number"))


def _check_travel(chunk: Samples, command: Array, travel: Travel) -> None:
    z = chunk.xyze[:, Z]
    low, high = travel.z
    if z.min() < low - SLACK or z.max() > high + SLACK:
        k = int(np.argmax((z < low - SLACK) | (z > high + SLACK)))
        bound = low if z[k] < low else high
        advice = "change travel.z in the profile if the printer allows it"
        raise LimitError("z (mm)", float(z[k]), bound, int(chunk.line[k]), advice)
    for axis, (low, high) in enumerate((travel.x, travel.y)):
        position = command[:, axis]
        if position.min() >= low - SLACK and position.max() <= high + SLACK:
            continue
        below = position.min() < low - SLACK
        k, bound = (int(position.argmin()), low) if below else (int(position.argmax()), high)
        off = abs(position[k] - chunk.xyze[k, axis])
        raise LimitError(
            f"{'xy'[axis]} (mm)", float(position[k]), bound, int(chunk.line[k]),
            f"the compensation adds {off:.3g} mm here: move the part inwards, or "
            "widen [travel] in the profile if the bed allows it", clampable=True,
        )  # fmt: skip


def _check_motors(chunk: Samples, rates: Rates, motors: Motors, clamped: bool) -> None:
    for name, unit, asked, limit in (
        ("velocity", "mm/s", rates.belt_velocity, motors.belt_velocity),
        ("acceleration", "mm/s²", rates.belt_acceleration, motors.belt_acceleration),
    ):
        if _greatest(asked) > limit * LEEWAY:
            magnitude = np.abs(asked).max(axis=0)
            k = int(magnitude.argmax())
            raise LimitError(
                f"belt {name} ({unit})", float(magnitude[k]), limit, int(chunk.line[k]),
                "raise effort in [compensation], lower the print's speed or acceleration, or "
                f"raise motors.belt_{name} if the motors can do it"
                + ("; clamping was not enough" if clamped else ""), clampable=not clamped,
            )  # fmt: skip


# ---------------------------------------------------------------------- the clamp


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
