"""Klipper as a player of the stream: its commands, and how it makes moves at rest."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from hframe_post.arrays import TS, Array, E, Flags, Integers, Z
from hframe_post.errors import PrinterError
from hframe_post.firmware.klipper.ramps import SQUARE_CORNER_VELOCITY, StreamLimits
from hframe_post.firmware.klipper.segments import sparser, thinned
from hframe_post.firmware.player import (
    SPARED,
    Dwelling,
    Rejoined,
    Stroke,
    Way,
    coordinates,
    plain,
)  # fmt: skip
from hframe_post.model.constant_acceleration import Trapezoid
from hframe_post.native.decimate import breakpoints, fitted
from hframe_post.native.ramps import klipper_durations, klipper_feeds
from hframe_post.printer.firmware_tables import KlipperTable
from hframe_post.printer.settings import Printer
from hframe_post.stream.types import ModalState, Rests

STAND = "G4 P0"  # comes to rest without flushing the queue of the motors, as M400 would
LABELS = re.compile(  # of objects: Klipper's commands, and lines that hosts replace by them
    rb"EXCLUDE_OBJECT_(START|END)\b|M486\b|;\s*(stop )?printing object\b|;MESH:", re.IGNORECASE
)
NUDGE = 0.001  # mm
MOST_LONGER = 1.1  # times a lift's own duration, to which it may be slowed down


@dataclass(frozen=True, slots=True)
class Klipper:
    """Klipper as a ``Player``.

    tolerance: mm by which the decimated command may miss a sample; None keeps every sample.
    travel: mm/s at which the machine may come back from where it left out moves. users_corner: the
    user's square corner velocity, mm/s. retract_moving: whether filament is retracted in motion,
    where every sample is written.
    """

    table: KlipperTable
    limits: StreamLimits
    tolerance: float | None = None
    travel: float = math.inf
    users_corner: float = 0.0
    retract_moving: bool = False

    @classmethod
    def from_printer(
        cls, printer: Printer, tolerance: float | None = None, retract_moving: bool = False
    ) -> Klipper:
        """Return Klipper as on this printer. Raises PrinterError without its table."""
        if printer.firmware.klipper is None:
            cause = "the table is missing: Klipper's own limits"
            raise PrinterError(cause, "firmware.klipper", printer.name)
        users = printer.limits
        limits = StreamLimits.from_limits(users, printer.motors, printer.kinematics)
        return cls(
            printer.firmware.klipper, limits, tolerance, users.velocity,
            users.square_corner_velocity, retract_moving,
        )  # fmt: skip

    @property
    def lines_per_second(self) -> float:
        return self.table.lines_per_second

    @property
    def notices(self) -> tuple[str, ...]:
        return ()

    @property
    def steady(self) -> int:
        return 0  # segments last as long as they are asked to

    @property
    def rests(self) -> Rests:
        """Return how lifts and retractions pass into motion.

        A lift passes no faster than a square corner of the user's, and comes to rest where every
        sample is written. Filament in motion changes its speed by a share of what Klipper allows
        the extruder at a junction, of which x and y need the most.
        """
        share = 0.3
        moving = share * self.limits.extruder_corner_velocity / TS if self.retract_moving else 0.0
        if self.tolerance is None:
            return Rests(retract_acceleration=moving)
        corner = self.limits.lift_corner
        return Rests(
            lift_speed=corner if corner <= self.users_corner else 0.0,
            needs_rest=self.labels_object,
            retract_acceleration=moving,
        )

    @property
    def limits_of_stream(self) -> list[str]:
        """Return the commands that set the stream's limits, with input shaping off."""
        limits = self.limits
        return [
            _shaper((0.0, 0.0, 0.0)),
            _limit(limits.velocity, limits.acceleration, SQUARE_CORNER_VELOCITY, 0.0),
        ]

    def begin(self, offset: tuple[float, float, float], at: Array) -> list[bytes]:
        macro = self.table.begin_macro
        start = [macro] if macro else self.limits_of_stream
        return [line.encode() for line in [STAND, *start, "G90", "M83", *coordinates(offset, at)]]

    def end(self, state: ModalState, at: Array) -> list[bytes]:
        table, names = self.table, coordinates(state.offset, at[:E] - state.offset)
        corner, cruise = table.square_corner_velocity, table.minimum_cruise_ratio
        stop = [_limit(table.velocity, table.acceleration, corner, cruise)]
        shaped = table.shaper_freq_x, table.shaper_freq_y, table.shaper_freq_z
        if any(shaped):
            stop.append(_shaper(shaped))
        if table.end_macro:
            stop.append(table.end_macro)
        return [line.encode() for line in [STAND, *stop, *names, *_modes(state)]]

    def modes_after(self, name: str) -> bytes:
        # G90 leaves E as it is
        return {"G91": b"G90\n", "M82": b"M83\n"}.get(name, b"")

    @staticmethod
    def labels_object(text: bytes) -> bool:
        return LABELS.match(text.lstrip()) is not None

    def rejoin(self, at: Array, way: Array, T: float) -> Rejoined:
        """Return a nudge with the user's acceleration, in which Klipper catches up.

        It does so in the first move that changes x or y, at the speed and acceleration of that.
        """
        table, to, axis = self.table, at.copy(), int(np.abs(way).argmax())
        to[axis] += math.copysign(NUDGE, way[axis])
        place = " ".join(f"{name}{plain(p, 6)}" for name, p in zip("XYZ", to, strict=False))
        speed, a = min(self.travel, table.velocity), table.acceleration
        text = (
            f"SET_VELOCITY_LIMIT ACCEL={plain(a, 0)}\n"
            f"G1 {place} F{plain(60.0 * speed, 1)}\n"
            f"SET_VELOCITY_LIMIT ACCEL={plain(self.limits.acceleration, 0)}\n"
        )
        end = min(math.hypot(*way) / T, math.sqrt(2.0 * a * NUDGE))
        peak = math.sqrt(a * NUDGE + end * end / 2.0)
        return Rejoined(text.encode(), to, end, (2.0 * peak - end) / a)

    def reset_extruder(self, filament: float) -> bytes:
        return b""  # Klipper counts in doubles

    def segments(self, points: Array, forced: Flags, last: bool) -> tuple[Integers, Array]:
        if self.tolerance is None:
            return np.arange(1, len(points)), points[1:]
        if self.retract_moving:
            back = np.flatnonzero(np.diff(points[:, E]) < 0.0)
            forced = forced.copy()
            forced[back] = forced[back + 1] = True
        ends = breakpoints(points, forced, self.tolerance)
        if self.lines_per_second < math.inf:
            ends = sparser(points, forced, self.tolerance, ends, SPARED * self.lines_per_second)
        ends = thinned(points, ends)
        return ends, fitted(points, ends)

    def possible_times(self, at: Array, T: Array, before: float) -> Array:
        return T

    def feeds(
        self, at: Array, T: Array, rest: Flags, before: float, after: float, per_feed: float
    ) -> tuple[Integers, Array]:
        return klipper_feeds(at, T, rest, before, after, self.limits.row, per_feed)

    def durations(
        self, at: Array, v: Array, rest: Flags, before: float, after: float = math.inf
    ) -> Array:
        return klipper_durations(at, v, rest, before, after, self.limits.row)

    def entry(self, at: Array, v: float, before: float) -> float:
        return min(v, before)

    def corners(
        self, way: Way, speed: float, planned: tuple[float, float], previous: Way | None = None
    ) -> tuple[float, float]:
        """Return the speeds in the corners of a lift that the plan joins to motion."""
        if planned == (0.0, 0.0):
            return planned
        lift = abs(way[1][Z] - way[0][Z])
        # a short lift needs the other half of its way to brake
        fits = math.sqrt(lift * self.limits.z_acceleration / 2.0)
        corner = min(self.limits.lift_corner, fits, speed, self.limits.z_velocity)
        into, out = planned
        return (corner if into else 0.0, corner if out else 0.0)

    def stroke(
        self, way: Way, speed: float, seconds: float, wanted: float,
        entry: float = 0.0, leaving: float = 0.0,
    ) -> Stroke:  # fmt: skip
        """Return the user's speed; a lift from or into motion is slowed down to be in time."""
        start, end = way
        lifted = abs(end[Z] - start[Z])
        if lifted and end[E] == start[E]:
            cruise, a = min(speed, self.limits.z_velocity), self.limits.z_acceleration
            lift = Trapezoid(lifted, cruise, a, entry, leaving)
            seconds = lift.seconds
            if entry or leaving:
                lift = lift.slowed_to(min(wanted, MOST_LONGER * seconds))
                speed, seconds = lift.cruise, lift.seconds
        return Stroke(speed, seconds, leaving)

    def dwell(self, seconds: float, next_to: Dwelling) -> tuple[bytes, float] | None:
        """Return G4, next to a lift even for no time.

        Without it Klipper would round the corner between lift and motion, and be early.
        """
        if next_to is not Dwelling.LIFT and seconds < TS / 2.0:
            return None
        waited = max(round(seconds, 6), 0.0)
        return b"G4 P%s\n" % plain(waited * 1e3, 3).encode(), waited


def _shaper(frequencies: Iterable[float]) -> str:
    """Return the command for x, y and z; a Klipper that does not shape z ignores its frequency."""
    axes = zip("XYZ", frequencies, strict=True)
    return " ".join(["SET_INPUT_SHAPER", *(f"SHAPER_FREQ_{a}={plain(f, 6)}" for a, f in axes)])


def _limit(velocity: float, acceleration: float, corner: float, cruise_ratio: float) -> str:
    return (
        f"SET_VELOCITY_LIMIT VELOCITY={plain(velocity, 6)} ACCEL={plain(acceleration, 6)} "
        f"SQUARE_CORNER_VELOCITY={plain(corner, 6)} MINIMUM_CRUISE_RATIO={plain(cruise_ratio, 6)}"
    )


def _modes(state: ModalState) -> list[str]:
    lines = [f"G1 F{plain(state.feed * 60.0, 1)}"]
    if state.absolute_e:
        lines += ["M82", f"G92 E{plain(state.e, 5)}"]
    if not state.absolute:
        lines.append("G91")
    return lines
