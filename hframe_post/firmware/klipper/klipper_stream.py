"""Klipper while the stream runs: its limits, what it is sent, and how it moves."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from hframe_post.arrays import TS, Array, E, Flags, Integers, Z
from hframe_post.firmware.base import unlimited
from hframe_post.firmware.code import Code, coordinates, modes, plain
from hframe_post.firmware.dialect import klipper_advance
from hframe_post.firmware.motion import USED_LINES_SHARE, MotionRules, NextTo, Stroke, Way
from hframe_post.model.kinematics import Trapezoid
from hframe_post.native.decimate import breakpoints, fitted, thinned
from hframe_post.native.planning import junction_deviation
from hframe_post.native.ramps import klipper_durations, klipper_feeds
from hframe_post.printer.firmware_tables import KlipperTable
from hframe_post.printer.settings import VELOCITY_HEADROOM, Extruder, Limits, Printer
from hframe_post.stream.types import ModalState, Passthrough, StopRules

STAND = "G4 P0"  # comes to rest without flushing the queue of the motors, as M400 would
SQUARE_CORNER_VELOCITY = 20.0  # mm/s, while the stream runs


@dataclass(frozen=True, slots=True)
class KlipperCode(Code):
    """Klipper's G-code.

    stream: the limits while it runs. extruder: whose pressure advance is averaged over a shorter
    time while it runs; None: nothing changes that.
    """

    table: KlipperTable
    stream: Limits
    extruder: Extruder | None = None

    @classmethod
    def from_printer(cls, printer: Printer) -> KlipperCode:
        """Return the G-code for this printer."""
        table = printer.firmware.own(KlipperTable)
        return cls(table, stream_limits(printer), averaged_shorter(printer.extruder))

    @property
    def limits_of_stream(self) -> list[str]:
        """Return the commands that set the stream's limits, with input shaping off."""
        own = self.stream
        return self.set_limits(own.velocity, own.acceleration, own.square_corner_velocity)

    @property
    def averaging_of_stream(self) -> list[str]:
        """Return the command that sets over what time the stream averages pressure advance."""
        return [] if self.extruder is None else [_averaging(self.extruder.stream_smooth_time)]

    def begin(self, offset: tuple[float, float, float], at: Array) -> list[str]:
        start = [STAND, *self.limits_of_stream, *self.averaging_of_stream, "G90", "M83"]
        return [*start, *coordinates(offset, at)]

    def users_limits(self, acceleration: float = math.inf) -> str:
        """Return the command that sets the user's limits. acceleration: the file's, if known."""
        table = self.table
        a = acceleration if acceleration < math.inf else table.acceleration
        return _limit(table.velocity, a, table.square_corner_velocity, table.minimum_cruise_ratio)

    def around(self, move: Passthrough) -> tuple[list[str], list[str]] | None:
        """Return lines that change limits alone: turning shaping on and off takes 40 ms each."""
        state = move.state
        if move.end is None or not state.absolute or any(state.offset):
            return None
        if state.absolute_e and b"E" in move.text.partition(b";")[0].upper():
            return None  # the stream's E is relative
        limits, feed = self.users_limits(state.acceleration), plain(state.feed * 60.0, 1)
        return [STAND, limits, f"G1 F{feed}"], [STAND, self.limits_of_stream[1]]

    def end(self, state: ModalState, at: Array) -> list[str]:
        table, names = self.table, coordinates(state.offset, at[:E] - state.offset)
        stop = [self.users_limits()]
        shaped = table.shaper_freq_x, table.shaper_freq_y, table.shaper_freq_z
        if any(shaped):
            stop.append(_shaper(shaped))
        if table.end_macro:
            stop.append(table.end_macro)
        if self.extruder is not None:
            own = self.extruder.smooth_time if state.smooth_time is None else state.smooth_time
            stop.append(_averaging(own))
        return [STAND, *stop, *names, *modes(state)]

    def modes_after(self, name: str, text: bytes) -> bytes:
        if self.extruder is not None and klipper_advance(text).smooth_time is not None:
            return b"".join(line.encode() + b"\n" for line in self.averaging_of_stream)
        return Code.modes_after(self, name, text)

    def set_limits(self, velocity: float, acceleration: float, corner: float) -> list[str]:
        return [_shaper((0.0, 0.0, 0.0)), _limit(velocity, acceleration, corner, 0.0)]


def stream_limits(printer: Printer) -> Limits:
    """Return Klipper's limits while the stream runs, which makes its own corners.

    acceleration: what the motors hold in any direction; a pause or a cancelled print brakes with no
    more than that. Neither is higher than the stream needs: an aborted print leaves them in force.
    """
    motors, kinematics = printer.motors, printer.kinematics
    return replace(
        unlimited(printer.limits),
        velocity=VELOCITY_HEADROOM * kinematics.max_speed_ratio * motors.belt_velocity,
        acceleration=math.floor(kinematics.min_speed_ratio * motors.belt_acceleration),
        square_corner_velocity=SQUARE_CORNER_VELOCITY,
    )


def averaged_shorter(extruder: Extruder | None) -> Extruder | None:
    """Return the extruder if the stream averages its pressure advance over a shorter time."""
    if extruder is None or extruder.stream_smooth_time >= extruder.smooth_time:
        return None
    return extruder


def _shaper(frequencies: Iterable[float]) -> str:
    """Return the command for x, y and z; a Klipper that does not shape z ignores its frequency."""
    axes = zip("XYZ", frequencies, strict=True)
    return " ".join(["SET_INPUT_SHAPER", *(f"SHAPER_FREQ_{a}={plain(f, 6)}" for a, f in axes)])


def _averaging(seconds: float) -> str:
    return f"SET_PRESSURE_ADVANCE SMOOTH_TIME={plain(seconds, 6)}"


def _limit(velocity: float, acceleration: float, corner: float, cruise_ratio: float) -> str:
    return (
        f"SET_VELOCITY_LIMIT VELOCITY={plain(velocity, 6)} ACCEL={plain(acceleration, 6)} "
        f"SQUARE_CORNER_VELOCITY={plain(corner, 6)} MINIMUM_CRUISE_RATIO={plain(cruise_ratio, 6)}"
    )


# ----------------------------------------------------------------------
# How Klipper makes moves of the stream and moves at rest.

MAX_LIFT_STRETCH = 1.1  # times a lift's own duration, to which it may be slowed down


@dataclass(frozen=True)
class KlipperMotion(MotionRules):
    """Klipper's motion.

    limits: those of Klipper while the stream runs. tolerance: mm by which the decimated command may
    miss a sample; None keeps every sample. users_corner: the user's square corner velocity, mm/s.
    """

    table: KlipperTable
    limits: Limits
    tolerance: float | None = None
    users_corner: float = 0.0

    @property
    def lines_per_second(self) -> float:
        return self.table.lines_per_second

    @cached_property
    def row(self) -> Array:
        """Return the limits and Klipper's junction deviation, mm, as loops take them, (8,)."""
        own = self.limits
        deviation = junction_deviation(own.square_corner_velocity, own.acceleration)
        return np.array([
            own.velocity, own.acceleration, own.z_velocity, own.z_acceleration,
            own.extruder_velocity, own.extruder_acceleration, own.extruder_corner_velocity,
            float(deviation),
        ])  # fmt: skip

    @property
    def lift_corner(self) -> float:
        """Return the speed, mm/s, of Klipper in the corner between a lift and motion in x, y."""
        own = self.limits
        return own.square_corner_velocity * math.sqrt(own.z_acceleration / own.acceleration)

    @property
    def stop_rules(self) -> StopRules:
        """Return how lifts and retractions pass into motion.

        A lift passes no faster than a square corner of the user's, and comes to rest where every
        sample is written.
        """
        corner = self.lift_corner
        passes = self.tolerance is not None and corner <= self.users_corner
        return StopRules(lift_speed=corner if passes else 0.0)

    def segments(self, points: Array, forced: Flags, last: bool) -> tuple[Integers, Array]:
        if self.tolerance is None:
            return np.arange(1, len(points)), points[1:]
        ends = breakpoints(points, forced, self.tolerance)
        if self.lines_per_second < math.inf:
            ends = sparser(
                points, forced, self.tolerance, ends, USED_LINES_SHARE * self.lines_per_second
            )
        ends = thinned(points, ends)
        return ends, fitted(points, ends)

    def feeds(
        self, at: Array, T: Array, rest: Flags, before: float, after: float, per_feed: float
    ) -> tuple[Integers, Array]:
        return klipper_feeds(at, T, rest, before, after, self.row, per_feed)

    def durations(
        self, at: Array, v: Array, rest: Flags, before: float, after: float = math.inf
    ) -> Array:
        return klipper_durations(at, v, rest, before, after, self.row)

    def corners(
        self, way: Way, speed: float, planned: tuple[float, float], previous: Way | None = None
    ) -> tuple[float, float]:
        """Return the speeds in the corners of a lift that the plan joins to motion."""
        if planned == (0.0, 0.0):
            return planned
        lift = abs(way.end[Z] - way.start[Z])
        # a short lift needs the other half of its way to brake
        fits = math.sqrt(lift * self.limits.z_acceleration / 2.0)
        corner = min(self.lift_corner, fits, speed, self.limits.z_velocity)
        into, out = planned
        return (corner if into else 0.0, corner if out else 0.0)

    def stroke(
        self, way: Way, speed: float, seconds: float, wanted: float,
        entry: float = 0.0, leaving: float = 0.0,
    ) -> Stroke:  # fmt: skip
        """Return the user's speed; a lift from or into motion is slowed down to be in time."""
        start, end, _ = way
        lifted = abs(end[Z] - start[Z])
        if lifted and end[E] == start[E]:
            cruise, a = min(speed, self.limits.z_velocity), self.limits.z_acceleration
            lift = Trapezoid(lifted, cruise, a, entry, leaving)
            seconds = lift.seconds
            if entry or leaving:
                lift = lift.slowed_to(min(wanted, MAX_LIFT_STRETCH * seconds))
                speed, seconds = lift.cruise, lift.seconds
        return Stroke(speed, seconds, leaving)

    def dwell(self, seconds: float, next_to: NextTo) -> tuple[bytes, float] | None:
        """Return G4, next to a lift even for no time.

        Without it Klipper would round the corner between lift and motion, and be early.
        """
        if next_to is not NextTo.LIFT and seconds < TS / 2.0:
            return None
        waited = max(round(seconds, 6), 0.0)
        return b"G4 P%s\n" % plain(waited * 1e3, 3).encode(), waited


# ----------------------------------------------------------------------
# Segments for Klipper: few of them, and none that it would refuse.

PIECE_SAMPLES = 250  # samples, within which the bound on lines is kept
TOLERANCE_GROWTH = 1.2  # times the tolerance, until a second has few enough segments


def sparser(
    points: Array, forced: Flags, tolerance: float, ends: Integers, rate: float
) -> Integers:
    """Return the breakpoints ``ends``, fewer wherever a second has more than ``rate`` of them.

    points, forced, tolerance: as for ``breakpoints``. In such a second the tolerance grows.
    """
    fewer = []
    for first in range(0, len(points) - 1, PIECE_SAMPLES):
        last = min(first + PIECE_SAMPLES, len(points) - 1)
        kept, allowed = ends[(ends > first) & (ends <= last)], rate * (last - first) * TS
        allowed = max(allowed, 1.0 + np.count_nonzero(forced[first + 1 : last]))
        coarse = tolerance
        while len(kept) > allowed:
            coarse *= TOLERANCE_GROWTH
            kept = first + breakpoints(points[first : last + 1], forced[first : last + 1], coarse)
        if coarse > tolerance and first:
            fewer.append(np.array([first]))
        fewer.append(kept)
    return np.unique(np.concatenate(fewer))
