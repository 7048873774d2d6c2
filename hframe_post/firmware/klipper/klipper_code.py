"""Klipper's G-code: the limits and modes of the stream, and those before and after it."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import astuple, dataclass
from functools import cached_property

import numpy as np

from hframe_post.arrays import Array, E
from hframe_post.firmware.code import Code, coordinates, modes, plain
from hframe_post.firmware.dialect import klipper_advance
from hframe_post.model.kinematics import Kinematics
from hframe_post.native.planning import junction_deviation
from hframe_post.printer.firmware_tables import KlipperTable
from hframe_post.printer.settings import VELOCITY_HEADROOM, Extruder, Limits, Motors, Printer
from hframe_post.stream.types import ModalState, Passthrough

STAND = "G4 P0"  # comes to rest without flushing the queue of the motors, as M400 would


@dataclass(frozen=True, slots=True)
class KlipperCode(Code):
    """Klipper's G-code.

    stream: the limits while it runs. extruder: whose pressure advance is averaged over a shorter
    time while it runs; None: nothing changes that.
    """

    table: KlipperTable
    stream: StreamLimits
    extruder: Extruder | None = None

    @classmethod
    def from_printer(cls, printer: Printer) -> KlipperCode:
        """Return the G-code for this printer."""
        stream = StreamLimits.from_limits(printer.limits, printer.motors, printer.kinematics)
        table = printer.firmware.own(KlipperTable)
        return cls(table, stream, averaged_shorter(printer.extruder))

    @property
    def limits_of_stream(self) -> list[str]:
        """Return the commands that set the stream's limits, with input shaping off."""
        limits = self.stream
        return [
            _shaper((0.0, 0.0, 0.0)),
            _limit(limits.velocity, limits.acceleration, SQUARE_CORNER_VELOCITY, 0.0),
        ]

    @property
    def averaging_of_stream(self) -> list[str]:
        """Return the command that sets over what time the stream averages pressure advance."""
        return [] if self.extruder is None else [_averaging(self.extruder.stream_smooth_time)]

    def begin(self, offset: tuple[float, float, float], at: Array) -> list[bytes]:
        start = [STAND, *self.limits_of_stream, *self.averaging_of_stream, "G90", "M83"]
        return [line.encode() for line in [*start, *coordinates(offset, at)]]

    def users_limits(self, acceleration: float = math.inf) -> str:
        """Return the command that sets the user's limits. acceleration: the file's, if known."""
        table = self.table
        a = acceleration if acceleration < math.inf else table.acceleration
        return _limit(table.velocity, a, table.square_corner_velocity, table.minimum_cruise_ratio)

    def around(self, move: Passthrough) -> tuple[bytes, bytes] | None:
        """Return lines that change limits alone: turning shaping on and off takes 40 ms each."""
        state = move.state
        if move.end is None or not state.absolute or any(state.offset):
            return None
        if state.absolute_e and b"E" in move.text.partition(b";")[0].upper():
            return None  # the stream's E is relative
        limits, feed = self.users_limits(state.acceleration), plain(state.feed * 60.0, 1)
        before, after = f"{STAND}\n{limits}\nG1 F{feed}\n", f"{STAND}\n{self.limits_of_stream[1]}\n"
        return before.encode(), after.encode()

    def end(self, state: ModalState, at: Array) -> list[bytes]:
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
        return [line.encode() for line in [STAND, *stop, *names, *modes(state)]]

    def modes_after(self, name: str, text: bytes) -> bytes:
        if self.extruder is not None and klipper_advance(text).smooth_time is not None:
            return b"".join(line.encode() + b"\n" for line in self.averaging_of_stream)
        return Code.modes_after(self, name, text)

    def set_limits(self, velocity: float, acceleration: float, corner: float) -> list[str]:
        v, a = plain(velocity, 0), plain(acceleration, 0)
        return [
            "SET_INPUT_SHAPER SHAPER_FREQ_X=0 SHAPER_FREQ_Y=0",
            f"SET_VELOCITY_LIMIT VELOCITY={v} ACCEL={a} MINIMUM_CRUISE_RATIO=0 "
            f"SQUARE_CORNER_VELOCITY={plain(corner, 2)}",
        ]


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
# Klipper's limits while the stream runs.

SQUARE_CORNER_VELOCITY = 20.0  # mm/s; the stream makes its own corners


@dataclass(frozen=True)
class StreamLimits:
    """Klipper's limits while the stream runs; mm, s.

    acceleration: what the motors hold in any direction. A pause or a cancelled print brakes with
    no more than that.
    """

    velocity: float
    acceleration: float
    z_velocity: float
    z_acceleration: float
    extruder_velocity: float
    extruder_acceleration: float
    extruder_corner_velocity: float

    @classmethod
    def from_limits(cls, limits: Limits, motors: Motors, kinematics: Kinematics) -> StreamLimits:
        # no higher than the stream needs: an aborted print leaves them in force
        return cls(
            VELOCITY_HEADROOM * kinematics.max_speed_ratio * motors.belt_velocity,
            math.floor(kinematics.min_speed_ratio * motors.belt_acceleration),
            limits.z_velocity, limits.z_acceleration, limits.extruder_velocity,
            limits.extruder_acceleration, limits.extruder_corner_velocity,
        )  # fmt: skip

    @cached_property
    def row(self) -> Array:
        """Return the limits and Klipper's junction deviation, mm, (8,)."""
        deviation = junction_deviation(SQUARE_CORNER_VELOCITY, self.acceleration)
        return np.array([*astuple(self), float(deviation)])

    @property
    def lift_corner(self) -> float:
        """Return the speed, mm/s, of Klipper in the corner between a lift and motion in x, y."""
        return SQUARE_CORNER_VELOCITY * math.sqrt(self.z_acceleration / self.acceleration)
