"""Checks of the model and of the commands before anything is written.

No command may leave the bed, outrun a motor, or ask for more than a real printer can need: each is
an error. ``clamp`` may instead reduce the compensation.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import chain

import numpy as np

from hframe_post.arrays import TS, Array, E, Z
from hframe_post.errors import HframeError, LimitError, PrinterError
from hframe_post.model.kinematics import Differences, Kinematics, Rates
from hframe_post.model.plant import Plant
from hframe_post.native.judging import farthest, is_safe
from hframe_post.printer.settings import Limits, Motors, Travel
from hframe_post.stream.chunks import stretches
from hframe_post.stream.marks import Marks
from hframe_post.stream.tally import tallied
from hframe_post.stream.types import Samples

LEEWAY, SLACK = 1.0 + 1e-9, 1e-9  # factor and mm by which a limit that is met exactly passes
SLOW_HZ = 3.0  # frequency at which lag and stiffness are read off a model
ADVICE = (
    "the [plant] of this profile does not describe this printer: measure it again, and run "
    "'hframe-post identify'"
)


# ---------------------------------------------------------------------- the model


def check_model(plant: Plant, limits: Limits) -> None:
    """Raise PrinterError if the gantry would twist more than any printer's."""
    if (G := plant.Gxtheta) is None:
        return
    omega = 2.0 * np.pi * SLOW_HZ
    slow = abs(complex(G.response(np.array([omega * TS]))[0]))
    angle = min(slow / omega * limits.velocity, slow / omega**2 * limits.acceleration)
    if angle > 0.02:  # rad
        raise PrinterError(
            f"this model twists the gantry by {1e3 * angle:.0f} mrad, more than any printer; "
            f"{ADVICE}",
            "plant.Gxtheta",
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
            k = farthest(chunk.xyze, command)
            off = float(np.hypot(*(command[k] - chunk.xyze[k, :Z])))
            if not off <= most:
                raise HframeError(
                    f"line {int(chunk.line[k])}: the compensation would move the nozzle "
                    f"{off:.1f} mm off its path; the lag of the model explains at "
                    f"most {most:.1f} mm. Probably {ADVICE}"
                )
        yield chunk


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

    belt_velocity: float = tallied(0.0, max)
    belt_acceleration: float = tallied(0.0, max)
    axis_acceleration: tuple[float, float] = tallied((0.0, 0.0), lambda *both: (*map(max, *both),))


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
        end: int | None = None  # of the last chunk of the stretch
        for stretch in stretches(chunks):
            differences = Differences(self._kinematics)
            for chunk in stretch:
                command = chunk.commands[strategy]
                _check_order(chunk, end)
                # samples of slow motion and of dwells may be left out after a stretch
                end = None if chunk.ends_stretch else chunk.end
                if len(chunk) and not self._safe(chunk, command, differences):
                    _check_finite(chunk, command)
                    _check_travel(chunk, command, self._travel)
                    rates = differences.rates(command)
                    _check_motors(chunk, rates, self._motors, self._clamped)
                    here = rates.belt_velocity, rates.belt_acceleration, *rates.axis_acceleration
                    self._peaks = np.maximum(self._peaks, [_greatest(rate) for rate in here])
                yield chunk

    def _safe(self, chunk: Samples, command: Array, differences: Differences) -> bool:
        """Return whether the command is safe; then note its rates."""
        before, belts = differences.before(command), self._kinematics.matrix
        return is_safe(chunk.xyze, command, before, self._limits, belts, self._peaks)


def _greatest(values: Array) -> float:
    return max(float(values.max()), -float(values.min()))


FAULT = "line {}: the command computed here {}; nothing was written. Please report this bug"


def _check_order(chunk: Samples, first: int | None) -> None:
    places = [chunk.first, chunk.end]
    for event in chunk.events:
        places[-1:-1] = event.at.tolist() if isinstance(event, Marks) else [event.index]
    if (first is not None and chunk.first != first) or places != sorted(places):
        line = int(chunk.line[0]) if len(chunk) else 0
        raise HframeError(FAULT.format(line, "goes back in time"))


def _check_finite(chunk: Samples, command: Array) -> None:
    finite = np.isfinite(command).all(axis=1) & np.isfinite(chunk.xyze).all(axis=1)
    if not finite.all():
        raise HframeError(FAULT.format(int(chunk.line[np.argmin(finite)]), "is not a number"))


def _check_travel(chunk: Samples, command: Array, travel: Travel) -> None:
    """Raise LimitError for the sample that is farthest outside the travel, z first."""
    (x, y), z = command.T, chunk.xyze[:, Z]
    for axis, place, (low, high) in (("z", z, travel.z), ("x", x, travel.x), ("y", y, travel.y)):
        outside = np.maximum(low - place, place - high)
        k = int(outside.argmax())
        if outside[k] <= SLACK:
            continue
        advice = "change travel.z in the profile if the printer allows it"
        if axis != "z":
            off = abs(place[k] - chunk.xyze[k, "xy".index(axis)])
            advice = (
                f"the compensation adds {off:.3g} mm here: move the part inwards, or "
                "widen [travel] in the profile if the bed allows it"
            )
        bound = low if place[k] < low else high
        raise LimitError(f"{axis} (mm)", float(place[k]), bound, int(chunk.line[k]), advice)


def _check_motors(chunk: Samples, rates: Rates, motors: Motors, clamped: bool) -> None:
    """Raise LimitError where a command outruns the motors."""
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
                + ("; clamping was not enough" if clamped else ""),
            )  # fmt: skip
