"""Klipper as a player of the stream: what it is told, and how it makes moves at rest."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

import numpy as np

from hframe_post.arrays import TS, Array, E, Flags, Integers, Z
from hframe_post.errors import PrinterError
from hframe_post.firmware.decimate import breakpoints, fitted
from hframe_post.firmware.klipper.segments import (
    LATE,
    SQUARE_CORNER_VELOCITY,
    Ramped,
    StreamLimits,
    made_up,
    thinned,
)
from hframe_post.firmware.player import (
    Dwelling,
    Rejoined,
    Stroke,
    coordinates,
    plain,
)
from hframe_post.model.trapezoid import Trapezoid
from hframe_post.printer.firmware_tables import KlipperTable
from hframe_post.printer.settings import Printer
from hframe_post.stream.types import ModalState, Rests

STAND = "G4 P0"  # comes to rest, but keeps what is queued for the motors, as M400 does not
LABELS = re.compile(  # of objects, by Klipper's commands and those that hosts put them for
    rb"EXCLUDE_OBJECT_(START|END)\b|M486\b|;\s*(stop )?printing object\b|;MESH:", re.IGNORECASE
)
NUDGE = 0.001  # mm
SHARE_OF_CORNER = 0.3  # that filament in motion changes its speed by in a sample
MOST_LONGER = 1.1  # times the duration of a lift that is made to be in time


def passing(printer: Printer) -> Rests:
    """How a lift passes from and into motion: no faster than a square corner of the user's."""
    corner = StreamLimits.of(printer.limits, printer.motors, printer.kinematics).lift_corner
    allowed = corner <= printer.limits.square_corner_velocity
    return Rests(corner=corner if allowed else 0.0, labels=labels_object)


def retracts_moving(printer: Printer) -> float:
    """Acceleration (mm/s²) of filament that is retracted in motion.

    At a junction Klipper lets extrusion change by the extruder's corner velocity, of which the
    change of x's and y's speed needs the most.
    """
    return SHARE_OF_CORNER * printer.limits.extruder_corner_velocity / TS


def labels_object(text: bytes) -> bool:
    """Whether a line is an object's start or end: a cancelled one's moves are left out."""
    return LABELS.match(text.lstrip()) is not None


@dataclass(frozen=True, slots=True)
class Klipper:
    """Klipper as a ``Player``.

    tolerance: mm by which the decimated command may miss a sample; None keeps them all.
    travel: mm/s at which a machine may catch up that comes from elsewhere. retracts_moving: whether
    filament is retracted in motion, which takes every sample there.
    """

    own: KlipperTable
    limits: StreamLimits
    tolerance: float | None = None
    travel: float = math.inf
    retracts_moving: bool = False

    @classmethod
    def of(cls, printer: Printer, tolerance: float | None = None) -> Klipper:
        """As that printer has it. Raises PrinterError where its profile does not know Klipper."""
        if printer.firmware.klipper is None:
            cause = "the table is missing: Klipper's own limits"
            raise PrinterError(cause, "firmware.klipper", printer.name)
        limits = StreamLimits.of(printer.limits, printer.motors, printer.kinematics)
        return cls(printer.firmware.klipper, limits, tolerance, printer.limits.velocity)

    @property
    def lines_per_second(self) -> float:
        """See ``Player``, as all of these. A host computer is never the bound."""
        return math.inf

    @property
    def limits_of_stream(self) -> list[str]:
        """Commands that set them, with shaping off."""
        limits = self.limits
        return [
            "SET_INPUT_SHAPER SHAPER_FREQ_X=0 SHAPER_FREQ_Y=0",
            _limit(limits.velocity, limits.acceleration, SQUARE_CORNER_VELOCITY, 0.0),
        ]

    def begin(self, offset: tuple[float, float, float], at: Array) -> list[bytes]:
        """Macros, where the profile names them, stand for the limits."""
        macro = self.own.begin_macro
        start = [macro] if macro else self.limits_of_stream
        return [line.encode() for line in [STAND, *start, "G90", "M83", *coordinates(offset, at)]]

    def end(self, state: ModalState, at: Array) -> list[bytes]:
        """As ``begin``."""
        own, names = self.own, coordinates(state.offset, at[:E] - state.offset)
        if self.own.end_macro:
            stop = [self.own.end_macro]
        else:
            stop = [
                _limit(
                    own.velocity, own.acceleration,
                    own.square_corner_velocity, own.minimum_cruise_ratio,
                )
            ]  # fmt: skip
            if own.shaper_freq_x or own.shaper_freq_y:
                x, y = own.shaper_freq_x, own.shaper_freq_y
                stop.append(
                    f"SET_INPUT_SHAPER SHAPER_FREQ_X={plain(x, 6)} SHAPER_FREQ_Y={plain(y, 6)}"
                )
        return [line.encode() for line in [STAND, *stop, *names, *_modes(state)]]

    def modes_after(self, name: str) -> bytes:
        """G90 means nothing to E."""
        return {"G91": b"G90\n", "M82": b"M83\n"}.get(name, b"")

    def labels_object(self, text: bytes) -> bool:
        """At an object's start and end: the moves of one that was cancelled are left out."""
        return labels_object(text)

    def rejoin(self, at: Array, way: Array, T: float) -> Rejoined:
        """Klipper catches up in the first move that changes x or y, with all that it asks for.

        So that is one with the user's acceleration, and not at the speed of a segment.
        """
        own, to, axis = self.own, at.copy(), int(np.abs(way).argmax())
        to[axis] += math.copysign(NUDGE, way[axis])
        place = " ".join(f"{name}{plain(p, 6)}" for name, p in zip("XYZ", to, strict=False))
        speed, a = min(self.travel, own.velocity), own.acceleration
        text = (
            f"SET_VELOCITY_LIMIT ACCEL={plain(a, 0)}\n"
            f"G1 {place} F{plain(60.0 * speed, 1)}\n"
            f"SET_VELOCITY_LIMIT ACCEL={plain(self.limits.acceleration, 0)}\n"
        )
        end = min(math.hypot(*way) / T, math.sqrt(2.0 * a * NUDGE))
        peak = math.sqrt(a * NUDGE + end * end / 2.0)
        return Rejoined(text.encode(), to, end, (2.0 * peak - end) / a)

    def reset_extruder(self) -> bytes:
        """Klipper counts in doubles."""
        return b""

    def segments(self, points: Array, forced: Flags, last: bool) -> tuple[Integers, Array]:
        """Decimated to the tolerance."""
        if self.tolerance is None:
            return np.arange(1, len(points)), points[1:]
        if self.retracts_moving:
            back = np.flatnonzero(np.diff(points[:, E]) < 0.0)
            forced = forced.copy()
            forced[back] = forced[back + 1] = True
        ends = thinned(points, breakpoints(points, forced, self.tolerance))
        return ends, fitted(points, ends)

    def possible_times(self, at: Array, T: Array, before: float) -> Array:
        """All of it."""
        return T

    def feed_rates(
        self, at: Array, T: Array, rest: Flags, before: float, after: float = math.inf
    ) -> Array:
        """Ramps in mind. What is late in spite of them is made up for by those after it."""
        ramped = Ramped.of(np.diff(at, axis=0), rest, self.limits, after)
        v = ramped.speeds(T, before)
        late = ramped.durations(v, before) - T
        if late.max() > LATE:
            v = ramped.speeds(made_up(T, np.where(late > LATE, late, 0.0)), before)
        return v

    def durations(
        self, at: Array, v: Array, rest: Flags, before: float, after: float = math.inf
    ) -> Array:
        """Ramps and limits in mind."""
        ramped = Ramped.of(np.diff(at, axis=0), rest, self.limits, after)
        return ramped.durations(v, before)

    def lift_corner(self, at: Array, speed: float) -> float:
        """At a right angle, of which a short lift can use only half of its way."""
        lift = abs(float(at[1, Z] - at[0, Z]))
        fits = math.sqrt(lift * self.limits.z_acceleration / 2.0)
        return min(self.limits.lift_corner, fits, speed, self.limits.z_velocity)

    def stroke(
        self, at: Array, speed: float, seconds: float, wanted: float,
        entry: float = 0.0, leaving: float = 0.0,
    ) -> Stroke:  # fmt: skip
        """As asked; a lift that passes from or into motion is slower, to be in time for it."""
        _, _, lifted, extruded = np.abs(at[1] - at[0]).tolist()
        if lifted and not extruded:
            cruise, a = min(speed, self.limits.z_velocity), self.limits.z_acceleration
            lift = Trapezoid(lifted, cruise, a, entry, leaving)
            if entry or leaving:
                lift = lift.slowed_to(min(wanted, MOST_LONGER * lift.seconds))
                speed = lift.cruise
            seconds = lift.seconds
        return Stroke(speed, seconds, leaving)

    def dwell(self, seconds: float, beside: Dwelling) -> tuple[bytes, float] | None:
        """G4, beside a lift even of no time.

        Without it Klipper would round the corner between a lift and the motion next to it,
        and be early.
        """
        if not beside.lifts and seconds < TS / 2.0:
            return None
        waited = max(round(seconds, 6), 0.0)
        return b"G4 P%s\n" % plain(waited * 1e3, 3).encode(), waited


def _limit(velocity: float, acceleration: float, corner: float, cruise_ratio: float) -> str:
    """SET_VELOCITY_LIMIT with everything that it can set."""
    values = {
        "VELOCITY": velocity,
        "ACCEL": acceleration,
        "SQUARE_CORNER_VELOCITY": corner,
        "MINIMUM_CRUISE_RATIO": cruise_ratio,
    }
    words = (f"{name}={plain(value, 6)}" for name, value in values.items())
    return " ".join(["SET_VELOCITY_LIMIT", *words])


def _modes(state: ModalState) -> list[str]:
    """Commands that bring the firmware to the modes and the E that a file believes in."""
    lines = [f"G1 F{plain(state.feed * 60.0, 1)}"]
    if state.absolute_e:
        lines += ["M82", f"G92 E{plain(state.e, 5)}"]
    if not state.absolute:
        lines.append("G91")
    return lines
