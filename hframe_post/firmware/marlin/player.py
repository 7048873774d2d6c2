"""Marlin as a player of the stream: whole steps, its limits, its commands.

1. Marlin rounds coordinates to whole steps of x and of y; belt motors then make x ± y of them.
2. A block in which no motor makes MIN_STEPS_PER_SEGMENT steps joins the next and moves at
   its speed. Segments are therefore long enough, and end on whole steps.
3. The motor with the most steps sets the pace, see ``planner``.
4. When the queue has run empty, Marlin waits for three blocks before it goes on. So the stream
   has no dwells of its own: standstill that no line of the file asks for is left out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hframe_post.arrays import TS, Array, E, Flags, Integers, Z
from hframe_post.errors import HframeError, PrinterError
from hframe_post.firmware.marlin.planner import Planner, make_planner
from hframe_post.firmware.player import (
    SPARED,
    VELOCITY_HEADROOM,
    Dwelling,
    Stroke,
    Way,
    coordinates,
    plain,
)  # fmt: skip
from hframe_post.model.kinematics import Kinematics
from hframe_post.native.block_times import Timer
from hframe_post.native.blocks import BlockLimits, Blocks, blocks_between
from hframe_post.native.ramps import speeds, whole_feeds
from hframe_post.native.whole_steps import motor_steps, segment_ends
from hframe_post.printer.firmware_tables import MarlinTable
from hframe_post.printer.settings import Limits, Motors, Printer, Steps
from hframe_post.stream.types import ModalState, Rests

HEADROOM = 2.0  # times the motors' acceleration; ramps last a step or two
JUNCTION_DEVIATION = 0.3  # mm, the most that M205 takes; the stream makes its own corners
SLOWEST_STROKE = 0.3  # of the speed that the file asks for
Z_JERK = 0.3  # mm/s, Marlin's default; profiles have none
JERK = 1000.0  # mm/s, the same where CLASSIC_JERK is built: more than any speed
FIXED_TIME, RAMPED = "M493 S1 X0 Y0 C0 P0", "M493 S0"  # on without a shaper, for any build; off
TRAPEZOIDS = "M494 T0 X0 Y0 Z0 E0"  # of 2026; another trajectory leaves ramps unplanned


@dataclass(frozen=True, slots=True)
class Marlin:
    """Marlin as a ``Player``. Lengths mm; rates are steps per second of the leading motor."""

    table: MarlinTable
    limits: Limits
    motors: Motors
    steps: Steps
    kinematics: Kinematics

    @classmethod
    def from_printer(
        cls, printer: Printer, tolerance: float | None = None, retract_moving: bool = False
    ) -> Marlin:
        """Return Marlin as on this printer. Raises PrinterError without its tables.

        tolerance: not used, segments are as long as whole steps make them. retract_moving: must
        be false, else HframeError.
        """
        if retract_moving:
            raise HframeError(
                "Marlin does not retract in motion: leave out --retract moving, or write for "
                "Klipper with --firmware klipper"
            )
        table, steps = printer.firmware.marlin, printer.steps
        if table is None or steps is None:
            key = "steps" if table else "firmware.marlin"
            raise PrinterError("the table is missing: Marlin needs it", key, printer.name)
        return cls(table, printer.limits, printer.motors, steps, printer.kinematics)

    @property
    def lines_per_second(self) -> float:
        return self.table.lines_received

    @property
    def notices(self) -> tuple[str, ...]:
        if self.lines_per_second == self.table.lines_per_second:
            return ()
        return (
            f"a serial line of {self.table.baud} baud carries {self.lines_per_second:.0f} lines in "
            "a second, so motion is coarser: raise its baud rate, or print from the SD card, "
            "without baud in the profile",
        )

    @property
    def steady(self) -> int:
        # whole steps and ticks leave blocks that no rate fits; their neighbours make up for it
        return 0 if self.planner.fixed_time else 50

    @property
    def rests(self) -> Rests:
        return Rests()  # lifts and retractions begin and end at rest

    def begin(self, offset: tuple[float, float, float], at: Array) -> list[bytes]:
        motion = FIXED_TIME if self.planner.fixed_time else RAMPED
        velocity = VELOCITY_HEADROOM * self.motors.belt_velocity
        a, v = plain(self._acceleration, 0), plain(velocity, 0)
        start = [
            "M400", "M593 F0", "M900 K0", motion, TRAPEZOIDS,
            f"M201 X{a} Y{a}{self._filament(self._acceleration)}", f"M203 X{v} Y{v}",
            f"M204 P{a} T{a}{self._retract(False)}", f"M205 B0 S0 T0 {self._corners(False)}",
        ]  # fmt: skip
        start += ["G90", "M83", *coordinates(offset, at)]
        return [line.encode() for line in [*start, *self._filling_lines(float(at[Z]))]]

    def _filling_lines(self, z: float) -> list[str]:
        """Return moves of z, up and down again, while which fixed-time motion fills its queue.

        It plans 128 ms ahead. With an empty queue it would plan to stop at the end of each line.
        """
        if not self.planner.fixed_time:
            return []
        steps = self.table.min_steps_per_segment
        way, seconds = steps * self.steps.z, 0.25
        feed = plain(60.0 * way / seconds, 2)
        return [f"G1 Z{plain(z + way, 5)} F{feed}", f"G1 Z{plain(z, 5)} F{feed}"]

    def end(self, state: ModalState, at: Array) -> list[bytes]:
        table = self.table
        (a_x, a_y), (v_x, v_y) = table.max_acceleration, table.max_velocity
        lines = [
            "M400",
            f"M201 X{plain(a_x, 3)} Y{plain(a_y, 3)}{self._filament(table.max_acceleration_e)}",
            f"M203 X{plain(v_x, 3)} Y{plain(v_y, 3)}",
            f"M204 P{plain(table.acceleration, 3)} T{plain(table.travel_acceleration, 3)}"
            f"{self._retract(True)}",
            f"M205 B{plain(table.min_segment_time * 1e6, 0)} S{plain(table.min_velocity, 3)} "
            f"T{plain(table.min_travel_velocity, 3)} {self._corners(True)}",
        ]
        if table.linear_advance:
            lines.append(f"M900 K{plain(table.linear_advance, 5)}")
        for axis, frequency in (("X", table.shaper_freq_x), ("Y", table.shaper_freq_y)):
            if frequency:
                lines.append(f"M593 {axis} F{plain(frequency, 3)}")
        if table.fixed_time_motion or self.planner.fixed_time:
            lines.append(f"M493 S{table.fixed_time_motion}")
        for axis, shaper in zip("XY", table.fixed_time_shaper, strict=True):
            if shaper:  # the mode is a word of the axis, or of C in later builds
                lines.append(f"M493 {axis}{shaper:.0f} C{shaper:.0f}")
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
        return [line.encode() for line in lines]

    def modes_after(self, name: str) -> bytes:
        # G90 and G91 set E, too; linear advance stays off
        modes = {"G90": b"M83\n", "G91": b"G90\nM83\n", "M82": b"M83\n", "M900": b"M900 K0\n"}
        return modes.get(name, b"")

    def labels_object(self, text: bytes) -> bool:
        return False  # it leaves no move out

    def rejoin(self, at: Array, way: Array, T: float) -> None:
        return None

    def reset_extruder(self, filament: float) -> bytes:
        # Marlin counts in floats: large ones lose the smallest moves. It rounds to whole steps,
        # of which the fraction must stay.
        return b"G92 E%s\n" % plain(filament % self.steps.e, 5).encode()

    def dwell(self, seconds: float, next_to: Dwelling) -> tuple[bytes, float] | None:
        # standstill is left out, and what follows makes up for it
        return (b"", 0.0) if next_to is Dwelling.MOTION else None

    def entry(self, at: Array, v: float, before: float) -> float:
        return float(self.planner.entry(self._blocks(at), np.array([v]), before)[0])

    def corners(
        self, way: Way, speed: float, planned: tuple[float, float], previous: Way | None = None
    ) -> tuple[float, float]:
        """Return the speeds of the user's corners: Marlin does not stop there, but to turn back.

        Corners are square. On from a stroke, both axes are at their limit.
        """
        if previous is not None and (np.subtract(*way) * np.subtract(*previous)).sum() < 0.0:
            return 0.0, self.corners(way, speed, planned)[1]
        at = np.array(way)
        lifts = bool(at[0, Z] != at[1, Z])
        if self.table.classic_jerk:
            into = out = Z_JERK if lifts else self.table.jerk_e
        else:
            n, d, a = (float(each[0]) for each in self._blocks(at)[:3])
            own = of_axis = a * d / n
            if not (lifts or self.planner.fixed_time):
                of_axis = self._filament_acceleration
            per_a = self.table.junction_deviation * math.sqrt(0.5) / (1.0 - math.sqrt(0.5))
            into, out = (math.sqrt(per_a * each) for each in (own, math.sqrt(2.0) * of_axis))
        return min(into, speed), min(out, speed)

    def stroke(
        self, way: Way, speed: float, seconds: float, wanted: float,
        entry: float = 0.0, leaving: float = 0.0,
    ) -> Stroke:  # fmt: skip
        """Return a stroke between the speeds of the user's corners, slower by the time this saves.

        With the stream's corners it would begin and end at full speed.
        """
        at = np.array(way)
        n, d, a, _ = blocks = self._blocks(at)
        a = a * d / n
        T = np.maximum(wanted, d / speed)
        v = float(speeds(d, T, a, np.array([math.inf, leaving]), entry)[0])
        v = min(max(v, SLOWEST_STROKE * speed), speed)
        if self.planner.fixed_time:
            v = max(v, leaving)
        v = math.ceil(60.0 * v) / 60.0  # F is whole, else its rounding may change a tick
        taken = self.planner.stroke(blocks, np.array([entry, leaving]), np.array([v]))[2]
        lifts = bool(at[0, Z] != at[1, Z])
        words = (self._stroke_corners(users, lifts) for users in (True, False))
        before, after = (f"M205 {word}\n".encode() if word else b"" for word in words)
        stroke = Stroke(v, float(taken[0]), min(leaving, v), before, after)
        if not self.planner.fixed_time:
            return stroke
        # it overshoots where the next block begins faster
        fastest = min(speed, math.sqrt(entry * entry + 2.0 * float((a * d)[0])))
        cruise = max(float((d - (v * v - entry * entry) / (2.0 * a))[0]), 0.0)
        return stroke._replace(fastest=fastest, cruise=cruise)

    def _stroke_corners(self, users: bool, lifts: bool) -> str:
        # what M205 needs for a retraction or a lift, other than the stream's
        if not self.table.classic_jerk:
            return self._corners(users)
        return "" if lifts else f"E{plain(self.table.jerk_e if users else JERK, 3)}"

    def _filament(self, acceleration: float) -> str:
        """Return the word of M201 for filament, if the profile knows what to restore.

        The user's limit would brake blocks by their steps of filament, which rounding changes.
        """
        return f" E{plain(acceleration, 3)}" if self.table.max_acceleration_e else ""

    @property
    def _filament_acceleration(self) -> float:
        """Return the limit of filament in motion, mm/s²."""
        known = self.table.max_acceleration_e > 0.0
        return self._acceleration if known else self.limits.extruder_acceleration

    def _retract(self, users: bool) -> str:
        """Return the word of M204 for the acceleration that retractions are planned with."""
        if not self.table.retract_acceleration:
            return ""
        limits = self.table.retract_acceleration, self.limits.extruder_acceleration
        return f" R{plain(limits[0] if users else limits[1], 3)}"

    def _corners(self, users: bool) -> str:
        table = self.table
        if not table.classic_jerk:
            return f"J{plain(table.junction_deviation if users else JUNCTION_DEVIATION, 4)}"
        x, y, e = (*table.jerk, table.jerk_e) if users else (JERK, JERK, JERK)
        return f"X{plain(x, 3)} Y{plain(y, 3)} E{plain(e, 3)}"

    @property
    def _acceleration(self) -> float:
        return HEADROOM * self.motors.belt_acceleration

    def segments(self, points: Array, forced: Flags, last: bool) -> tuple[Integers, Array]:
        """Return segments on whole steps. A line of the file waits for the end of its segment."""
        cells = np.rint(points[:, :Z] / self.steps.belt).astype(np.int64)
        apart = 1.0 / (TS * SPARED * self.lines_per_second)
        ends = segment_ends(
            motor_steps(cells, self.kinematics.matrix), self.table.min_steps_per_segment,
            max(1, int(np.ceil(round(apart, 6)))), round(self.planner.stall / TS), last,
        )  # fmt: skip
        at = points[ends]
        at[:, :Z] = cells[ends] * self.steps.belt
        return ends, at

    def possible_times(self, at: Array, T: Array, before: float) -> Array:
        """Return times no longer than the slowest steps, no shorter than the first from rest."""
        return self.planner.possible_times(self._blocks(at), T, before)

    def feeds(
        self, at: Array, T: Array, rest: Flags, before: float, after: float, per_feed: float
    ) -> tuple[Integers, Array]:
        blocks = self._blocks(at, after)
        feeds = whole_feeds(self.planner.feed_rates(blocks, T, before), per_feed)
        return feeds, self.planner.durations(blocks, feeds / per_feed, before)

    def durations(
        self, at: Array, v: Array, rest: Flags, before: float, after: float = math.inf
    ) -> Array:
        return self.planner.durations(self._blocks(at, after), v, before)

    @property
    def planner(self) -> Planner:
        t = self.table
        return make_planner(t.planner, self._timer, t.classic_jerk, t.s_curve_acceleration)

    @property
    def _timer(self) -> Timer:
        t = self.table
        return Timer(t.timer_hz, t.timer_extra_tick, t.adaptive_step_smoothing)

    def _blocks(self, at: Array, after: float = math.inf) -> Blocks:
        limits = BlockLimits(
            self.steps.belt, self.steps.z, self.steps.e, self._acceleration,
            self.limits.z_acceleration, self._filament_acceleration,
            self.limits.extruder_acceleration,
            math.inf if self.table.classic_jerk else JUNCTION_DEVIATION,
        )  # fmt: skip
        return blocks_between(at, after, limits, self.kinematics.matrix)
