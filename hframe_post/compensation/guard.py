"""Checks of the model and of the commands before anything is written.

No command may leave the bed, outrun a motor, or ask for more than a real printer can need: each is
an error. ``clamp`` may instead reduce the compensation.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np

from hframe_post.arrays import TS, Array, E, Z
from hframe_post.compensation.clamp import AROUND, BELOW, SLACK, Clamp, Clamped
from hframe_post.errors import HframeError, LimitError, PrinterError
from hframe_post.model.kinematics import Differences, Kinematics, Rates
from hframe_post.model.plant import Plant
from hframe_post.native.judging import is_near, peaks_if_safe
from hframe_post.printer.settings import Limits, Motors, Travel
from hframe_post.stream.chunks import join, part, stretches
from hframe_post.stream.marks import Marks
from hframe_post.stream.tally import tallied
from hframe_post.stream.types import Samples

LEEWAY = 1.0 + 1e-9  # factor by which a limit of belts that is met exactly passes
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
            if not is_near(chunk.xyze, command, most):
                off = np.hypot(*(command - chunk.xyze[:, :Z]).T)
                k = int(off.argmax())
                raise HframeError(
                    f"line {int(chunk.line[k])}: the compensation would move the nozzle "
                    f"{off[k]:.1f} mm off its path; the lag of the model explains at "
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

_Judged = tuple[Samples, Array | None]  # the greatest rates (4,) of its command, if it is safe


@dataclass(frozen=True, slots=True)
class Peaks:
    """Greatest rates of the commands, mm/s and mm/s²; axis_acceleration: x, y."""

    belt_velocity: float = tallied(0.0, max)
    belt_acceleration: float = tallied(0.0, max)
    axis_acceleration: tuple[float, float] = tallied((0.0, 0.0), lambda *both: (*map(max, *both),))


class Guard:
    """Passes commands that are safe. ``peaks``: rates of what has passed so far.

    clamp: whether to reduce the compensation where a command asks too much; ``clamped``: what was
    changed.
    """

    def __init__(
        self, travel: Travel, motors: Motors, kinematics: Kinematics, clamp: bool = False
    ) -> None:
        self._travel, self._motors, self._kinematics = travel, motors, kinematics
        self._clamp = Clamp(travel, motors, kinematics) if clamp else None
        axes = ((low - SLACK, high + SLACK) for low, high in (travel.z, travel.x, travel.y))
        leeway = BELOW if clamp else LEEWAY
        belts = motors.belt_velocity * leeway, motors.belt_acceleration * leeway
        self._limits = np.array([*chain(*axes), *belts])
        self._peaks = np.zeros(4)

    @property
    def peaks(self) -> Peaks:
        """Return the greatest rates so far."""
        velocity, acceleration, x, y = self._peaks.tolist()
        return Peaks(velocity, acceleration, (x, y))

    @property
    def clamped(self) -> Clamped:
        """Return what was changed so far."""
        return self._clamp.clamped if self._clamp else Clamped()

    def check(self, chunks: Iterable[Samples], strategy: str) -> Iterator[Samples]:
        """Yield the chunks. Raise LimitError for an unsafe command, HframeError for a bug."""
        for stretch in stretches(_in_order(chunks)):
            differences = Differences(self._kinematics)
            judged = self._judged(stretch, strategy)
            for chunk, peaks in self._limited(judged, strategy) if self._clamp else judged:
                command = chunk.commands[strategy]
                if peaks is None:
                    peaks = self._look(chunk, command, differences)
                differences.pass_by(command)
                self._peaks = np.maximum(self._peaks, peaks)
                yield chunk

    def _judged(self, stretch: Iterable[Samples], strategy: str) -> Iterator[_Judged]:
        """Yield the chunks at a glance."""
        differences, belts = Differences(self._kinematics), self._kinematics.matrix
        for chunk in stretch:
            command, peaks = chunk.commands[strategy], None
            if len(chunk):
                before = differences.before(command)
                peaks = peaks_if_safe(chunk.xyze, command, before, self._limits, belts)
                differences.pass_by(command)
            yield chunk, peaks if len(chunk) else np.zeros(4)

    def _limited(self, judged: Iterable[_Judged], strategy: str) -> Iterator[_Judged]:
        """Yield the chunks of a stretch with less compensation near what is not safe."""
        assert self._clamp
        past, waiting, changed = deque[_Judged](), deque[_Judged](), False
        for each in chain(judged, [None]):
            if each is not None:
                waiting.append(each)
            while waiting and (each is None or waiting[-1][0].end - waiting[0][0].end >= AROUND):
                chunk, peaks = waiting[0]
                new = chunk
                if any(found is None for _, found in (*past, *waiting)):
                    new = self._clamp.limited(chunk, _around(past, waiting), strategy)
                if len(chunk):
                    follows, changed = changed, new is not chunk
                    peaks = None if follows or changed else peaks
                yield new, peaks
                past.append(waiting.popleft())
                while past and past[0][0].end <= chunk.end - AROUND:
                    past.popleft()

    def _look(self, chunk: Samples, command: Array, differences: Differences) -> Array:
        """Return the greatest rates of a command. Raise an error that says why it is not safe."""
        _check_finite(chunk, command)
        _check_travel(chunk, command, self._travel)
        rates = differences.rates(command)
        _check_motors(chunk, rates, self._motors, self._clamp is not None)
        return np.array([
            _greatest(rates.belt_velocity), _greatest(rates.belt_acceleration),
            *map(_greatest, rates.axis_acceleration),
        ])  # fmt: skip


def _around(past: Iterable[_Judged], waiting: Sequence[_Judged]) -> Samples:
    """Return the first of the chunks that wait, and AROUND samples on either side of it."""
    wide, own = join([chunk for chunk, _ in (*past, *waiting)]), waiting[0][0]
    start = own.first - wide.first
    end = start + len(own) + AROUND
    return part(wide, max(start - AROUND, 0), min(end, len(wide)))


def _greatest(values: Array) -> float:
    return max(float(values.max()), -float(values.min()))


FAULT = "line {}: the command computed here {}; nothing was written. Please report this bug"


def _in_order(chunks: Iterable[Samples]) -> Iterator[Samples]:
    """Yield the chunks. Raise HframeError if samples or events are repeated or left out."""
    end: int | None = None  # of the last chunk of the stretch
    for chunk in chunks:
        places = [chunk.first, chunk.end]
        for event in chunk.events:
            places[-1:-1] = event.at.tolist() if isinstance(event, Marks) else [event.index]
        if (end is not None and chunk.first != end) or places != sorted(places):
            line = int(chunk.line[0]) if len(chunk) else 0
            raise HframeError(FAULT.format(line, "goes back in time"))
        # samples of slow motion and of dwells may be left out after a stretch
        end = None if chunk.ends_stretch else chunk.end
        yield chunk


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
