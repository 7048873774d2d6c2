"""Marlin's G-code: the settings of the stream, and those before and after it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np

from hframe_post.arrays import Array, E, Z
from hframe_post.firmware.code import Code, coordinates, plain
from hframe_post.firmware.marlin.planner import BRAKES_LATE_STEPS, Planner, make_planner
from hframe_post.native.planning import junction_deviation, square_corner_velocity
from hframe_post.native.whole_steps import Blocks
from hframe_post.printer.firmware_tables import MarlinTable
from hframe_post.printer.settings import VELOCITY_HEADROOM, Limits, Motors, Printer, Steps
from hframe_post.stream.types import ModalState

ACCELERATION_HEADROOM = 2.0  # times the motors' acceleration; ramps last a step or two
DEVIATIONS = 0.01, 0.3  # mm, that M205 J takes; with the most the stream makes its own corners
JERK_MM_S = 1000.0  # mm/s, where CLASSIC_JERK is built: more than any speed
FIXED_TIME, RAMPED = "M493 S1 X0 Y0 C0 P0", "M493 S0"  # on without a shaper, for any build; off
TRAPEZOIDS = "M494 T0 X0 Y0 Z0 E0"  # of 2026; another trajectory leaves ramps unplanned


def motion_limits(
    velocity: float, acceleration: float, corners: str, filament: str = ""
) -> list[str]:
    """Return the lines that set limits of motion, and no least speed or time of a segment.

    corners: words of M205; filament: a further word of M201.
    """
    v, a = plain(velocity, 0), plain(acceleration, 0)
    return [
        f"M201 X{a} Y{a}{filament}", f"M203 X{v} Y{v}", f"M204 P{a} T{a}",
        f"M205 B0 S0 T0 {corners}",
    ]  # fmt: skip


@dataclass(frozen=True)
class MarlinCode(Code):
    """Marlin's G-code. limits: the user's."""

    when_stopped: ClassVar[str] = "M501 and M82 (without EEPROM: switch the printer off and on)"

    table: MarlinTable
    limits: Limits
    motors: Motors
    steps: Steps

    @classmethod
    def from_printer(cls, printer: Printer) -> MarlinCode:
        """Return the G-code for this printer."""
        assert printer.steps is not None  # see `check_needs`
        table = printer.firmware.own(MarlinTable)
        return cls(table, printer.limits, printer.motors, printer.steps)

    @property
    def notices(self) -> tuple[str, ...]:
        received = self.table.lines_received
        if received == self.table.lines_per_second:
            return ()
        return (
            f"a serial line of {self.table.baud} baud, with a sender that takes "
            f"{1e3 * self.table.latency:g} ms (latency), carries {received:.0f} lines in a second, "
            "so motion is coarser: raise its baud rate, or print from the SD card, without baud in "
            "the profile",
        )

    @property
    def after_homing(self) -> list[str]:
        return ["M420 S1"] if self.table.bed_levelling else []

    @cached_property
    def planner(self) -> Planner:
        return make_planner(self.table)

    def durations(self, lead: Array, d: Array, v_s: Array, v_e: Array, v: Array, a: Array) -> Array:
        """Return the seconds (n,) of moves as the board steps them; see ``Durations``."""
        steps = np.maximum(np.rint(lead), 1.0)
        blocks = Blocks(steps, d, np.floor(a * steps / d))
        if self.table.planner == "2.1-dev":
            least = np.minimum(self.planner.least_entry(blocks), v)
            v_s, v_e = np.maximum(v_s, least), np.maximum(v_e, least)
        return self.planner.seconds(blocks, v_s, v_e, v)

    @property
    def brakes_late(self) -> float:
        """Return the way by which the board brakes late, mm."""
        return BRAKES_LATE_STEPS[self.table.planner] * self.steps.belt

    @property
    def motion_mode(self) -> str:
        """Return the line that turns fixed-time motion on or off, as the board is built."""
        return FIXED_TIME if self.planner.fixed_time else RAMPED

    @property
    def filament_acceleration(self) -> float:
        """Return the limit of filament in motion, mm/s²."""
        known = self.table.max_acceleration_e > 0.0
        return self.block_acceleration if known else self.limits.extruder_acceleration

    @property
    def block_acceleration(self) -> float:
        """Return the acceleration of the stream's blocks, mm/s²."""
        return ACCELERATION_HEADROOM * self.motors.belt_acceleration

    @property
    def jerk_e(self) -> float:
        """Return the sudden change of E's speed, mm/s, that the user allows."""
        if self.table.classic_jerk:
            return self.table.jerk_e
        acceleration = self.table.max_acceleration_e or self.limits.extruder_acceleration
        return square_corner_velocity(self.table.junction_deviation, acceleration)

    def begin(self, offset: tuple[float, float, float], at: Array) -> list[str]:
        v, a = VELOCITY_HEADROOM * self.motors.belt_velocity, self.block_acceleration
        limits = motion_limits(v, a, self.corners(False), self._filament(a))
        start = ["M400", "M593 F0", "M900 K0", self.motion_mode, TRAPEZOIDS, *limits]
        return [*start, "G90", "M83", *coordinates(offset, at), *self.filling_lines(float(at[Z]))]

    def filling_lines(self, z: float) -> list[str]:
        """Return moves of z, up and down again, while which fixed-time motion fills its queue.

        It plans 128 ms ahead. With an empty queue it would plan to stop at the end of each line. A
        block whose next one begins faster overshoots by v² / 2a: with the user's acceleration of z,
        by 50 µm into the bed, and comes back within a millisecond.
        """
        if not self.planner.fixed_time:
            return []
        steps = self.table.min_steps_per_segment
        way, seconds = steps * self.steps.z, 0.25
        feed = plain(60.0 * way / seconds, 2)
        stiff, users = (plain(a, 3) for a in (self.block_acceleration, self.limits.z_acceleration))
        moves = f"G1 Z{plain(z + way, 5)} F{feed}", f"G1 Z{plain(z, 5)} F{feed}"
        return [f"M201 Z{stiff}", *moves, f"M201 Z{users}"]

    def end(self, state: ModalState, at: Array) -> list[str]:
        table = self.table
        (a_x, a_y), (v_x, v_y) = table.max_acceleration, table.max_velocity
        lines = [
            "M400",
            f"M201 X{plain(a_x, 3)} Y{plain(a_y, 3)} Z{plain(self.limits.z_acceleration, 3)}"
            f"{self._filament(table.max_acceleration_e)}",
            f"M203 X{plain(v_x, 3)} Y{plain(v_y, 3)}",
            f"M204 P{plain(table.acceleration, 3)} T{plain(table.travel_acceleration, 3)}"
            f"{self._retract(table.retract_acceleration)}",
            f"M205 B{plain(table.min_segment_time * 1e6, 0)} S{plain(table.min_velocity, 3)} "
            f"T{plain(table.min_travel_velocity, 3)} {self.corners(True)}",
        ]
        advance = table.linear_advance if state.advance is None else state.advance
        if advance:
            lines.append(f"M900 K{plain(advance, 5)}")
        for axis, frequency in (("X", table.shaper_freq_x), ("Y", table.shaper_freq_y)):
            if frequency:
                lines.append(f"M593 {axis} F{plain(frequency, 3)}")
        if table.fixed_time_motion or self.planner.fixed_time:
            lines.append(f"M493 S{table.fixed_time_motion}")
        for axis, shaper in zip("XY", table.fixed_time_shaper, strict=True):
            if shaper:  # the mode is a word of the axis, or of C in later builds
                lines.append(f"M493 {axis}{shaper:.0f} C{shaper:.0f}")
        smoothing = *table.fixed_time_smoothing, *table.fixed_time_smoothing_z_e
        if table.fixed_time_trajectory or any(smoothing):
            named = zip("XYZE", smoothing, strict=True)
            words = (f"{axis}{plain(seconds, 4)}" for axis, seconds in named)
            lines.append(f"M494 T{table.fixed_time_trajectory} {' '.join(words)}")
        lines += [
            *coordinates(state.offset, at[:E] - state.offset),
            f"G1 F{plain(state.feed * 60, 1)}",
        ]
        if not state.absolute:
            lines.append("G91")  # before M82: it makes E relative, too
        if state.absolute_e:
            lines.append("M82")
        # also for a relative E, which Marlin counts on: a later G90 makes it absolute
        lines.append(f"G92 E{plain(state.e, 5)}")
        return lines

    def modes_after(self, name: str, text: bytes) -> bytes:
        # G90 and G91 set E, too; linear advance stays off
        modes = {"G90": b"M83\n", "G91": b"G90\nM83\n", "M82": b"M83\n", "M900": b"M900 K0\n"}
        return modes.get(name, b"")

    def reset_extruder(self, filament: float) -> bytes:
        # Marlin counts in floats: large ones lose the smallest moves. It rounds to whole steps,
        # of which the fraction must stay.
        return b"G92 E%s\n" % plain(filament % self.steps.e, 5).encode()

    def set_limits(self, velocity: float, acceleration: float, corner: float) -> list[str]:
        corners = f"X{plain(corner, 2)} Y{plain(corner, 2)}"
        if not self.table.classic_jerk:
            corners = f"J{plain(float(junction_deviation(corner, acceleration)), 4)}"
        limits = motion_limits(velocity, acceleration, corners)
        return ["M400", "M593 F0", TRAPEZOIDS, RAMPED, *limits]

    def corner_range(self, acceleration: float) -> tuple[float, float]:
        if self.table.classic_jerk:
            return 0.0, math.inf
        least, most = (square_corner_velocity(each, acceleration) for each in DEVIATIONS)
        return least, most

    def stroke_corners(self, users: bool, lifts: bool) -> str:
        """Return what M205 needs for a retraction or a lift, other than the stream's."""
        if not self.table.classic_jerk:
            return self.corners(users)
        return "" if lifts else f"E{plain(self.table.jerk_e if users else JERK_MM_S, 3)}"

    def _filament(self, acceleration: float) -> str:
        """Return the word of M201 for filament, if the profile knows what to restore.

        The user's limit would brake blocks by their steps of filament, which rounding changes.
        """
        return f" E{plain(acceleration, 3)}" if self.table.max_acceleration_e else ""

    def _retract(self, acceleration: float) -> str:
        """Return the word of M204 for retractions, if the profile knows what to restore."""
        return f" R{plain(acceleration, 3)}" if self.table.retract_acceleration else ""

    def stroke_limit(self, acceleration: float, lifts: bool) -> bytes:
        """Return the line that sets the acceleration, mm/s², of a lift or a retraction."""
        if acceleration == math.inf:
            return b""
        word = f" Z{plain(acceleration, 3)}" if lifts else self._retract(acceleration)
        return f"{'M201' if lifts else 'M204'}{word}\n".encode() if word else b""

    def corners(self, users: bool) -> str:
        """Return the words of M205 for the user's corners or the stream's."""
        table = self.table
        if not table.classic_jerk:
            return f"J{plain(table.junction_deviation if users else DEVIATIONS[1], 4)}"
        x, y, e = (*table.jerk, table.jerk_e) if users else (JERK_MM_S, JERK_MM_S, JERK_MM_S)
        return f"X{plain(x, 3)} Y{plain(y, 3)} E{plain(e, 3)}"
