"""Marlin's motion: whole steps, its planners, its corners.

1. Marlin rounds coordinates to whole steps of x and of y; belt motors then make x ± y of them.
2. A block in which no motor makes MIN_STEPS_PER_SEGMENT steps joins the next and moves at
   its speed. Segments are therefore long enough, and end on whole steps.
3. The motor with the most steps sets the pace, see ``planner``.
4. When the queue has run empty, Marlin waits for three blocks before it goes on. So the stream
   has no dwells of its own: a dwell that no line of the file asks for is left out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from hframe_post.arrays import TS, Array, Flags, Integers, Z
from hframe_post.firmware.code import plain
from hframe_post.firmware.dialect import ExtruderLimits
from hframe_post.firmware.marlin.marlin_code import (
    DEVIATIONS,
    TRAPEZOIDS,
    MarlinCode,
    motion_limits,
)
from hframe_post.firmware.marlin.planner import Planner, along
from hframe_post.firmware.motion import (
    USED_LINES_SHARE,
    MotionRules,
    NextTo,
    Stroke,
    Way,
    WrittenMoves,
)
from hframe_post.model.kinematics import Kinematics
from hframe_post.native.planning import square_corner_velocity
from hframe_post.native.ramps import speeds, whole_feeds
from hframe_post.native.whole_steps import (
    BlockLimits,
    Blocks,
    blocks_between,
    most_steps,
    motor_places,
    motor_steps,
    segment_ends,
    slow_segment_ends,
    with_late_starts,
    without_reversals,
)
from hframe_post.stream.types import StopRules

MIN_STROKE_SHARE = 0.3  # of the speed that it reaches from rest to rest
Z_JERK_MM_S = 0.3  # mm/s, Marlin's default; profiles have none


@dataclass(frozen=True, slots=True)
class MarlinMotion(MotionRules):
    """Marlin's motion under the settings of its G-code.

    Lengths are in mm, rates in steps per second of the leading motor.
    """

    code: MarlinCode
    kinematics: Kinematics

    @property
    def planner(self) -> Planner:
        return self.code.planner

    @property
    def lines_per_second(self) -> float:
        return self.code.table.lines_received

    @property
    def stop_rules(self) -> StopRules:
        return StopRules(joined=not self.code.table.classic_jerk)

    @property
    def steady(self) -> int:
        # whole steps and ticks leave blocks that no rate fits; their neighbours make up for it
        return 0 if self.planner.fixed_time else 50

    def head_start(self, at: Array) -> Array:
        # else the command is ahead of the first segment that makes a step by the slow ones
        longer = np.zeros(len(at) - 1)
        moving = np.any(np.diff(np.rint(at[:, :Z] / self.code.steps.belt), axis=0), axis=1)
        longer[moving.argmax()] = self.planner.stall
        return longer

    @property
    def extruder(self) -> ExtruderLimits:
        """Return the limits of E: those of M203, M201 and, from line to line, of M205.

        Rounding to whole steps makes a line faster by a step.
        """
        lines, users = USED_LINES_SHARE * self.lines_per_second, self.code.limits
        least = 0.1 * users.extruder_velocity
        velocity = max(
            USED_LINES_SHARE * users.extruder_velocity - self.code.steps.e * lines, least
        )
        acceleration = self.code.table.max_acceleration_e or users.extruder_acceleration
        return ExtruderLimits(velocity, min(acceleration, self.code.jerk_e * lines))

    def dwell(self, seconds: float, next_to: NextTo) -> tuple[bytes, float] | None:
        # a dwell is left out, and what follows makes up for it
        return (b"", 0.0) if next_to is NextTo.MOTION else None

    def entry(self, at: Array, v: float, before: float) -> float:
        return float(self.planner.entry(self._blocks(at), np.array([v]), before)[0])

    def corners(
        self, way: Way, speed: float, planned: tuple[float, float], previous: Way | None = None
    ) -> tuple[float, float]:
        """Return the speeds of the user's corners: Marlin does not stop there, but to turn back.

        Corners are square. On from a stroke, both axes are at their limit.
        """
        at = np.array(way[:2])
        if previous is not None and (np.subtract(*at) * np.subtract(*previous[:2])).sum() < 0.0:
            return 0.0, self.corners(way, speed, planned)[1]
        lifts = bool(at[0, Z] != at[1, Z])
        if self.code.table.classic_jerk:
            into = out = Z_JERK_MM_S if lifts else self.code.table.jerk_e
        else:
            own = of_axis = float(along(self._block(way))[0])
            if not (lifts or self.planner.fixed_time):
                of_axis = self.code.filament_acceleration
            J, asked = self.code.table.junction_deviation, (own, math.sqrt(2.0) * of_axis)
            into, out = (square_corner_velocity(J, each) for each in asked)
        return min(into, speed), min(out, speed)

    def stroke(
        self, way: Way, speed: float, seconds: float, wanted: float,
        entry: float = 0.0, leaving: float = 0.0,
    ) -> Stroke:  # fmt: skip
        """Return a stroke between the speeds of the user's corners, slower by the time this saves.

        With the stream's corners it would begin and end at full speed. leaving: inf if it ends at
        its own speed.
        """
        lifts = way.end[Z] != way.start[Z]
        blocks = self._block(way)
        d, a = blocks.d, along(blocks)
        T = np.maximum(wanted, d / speed)
        v = float(speeds(d, T, a, np.array([math.inf, leaving]), entry)[0])
        reached = min(speed, float(np.sqrt(a * d)[0]))
        v = min(max(v, MIN_STROKE_SHARE * reached), speed)
        if self.planner.fixed_time and leaving < math.inf:
            v = max(v, leaving)
        v = math.ceil(60.0 * v) / 60.0  # F is whole, else its rounding may change a tick
        left = min(leaving, v)
        own = np.array([v])
        between = self.planner.reachable(blocks, np.array([entry, left]), own)
        taken = self.planner.seconds(blocks, *between, own)
        words = (self.code.stroke_corners(users, lifts) for users in (True, False))
        before, after = (f"M205 {word}\n".encode() if word else b"" for word in words)
        limit = self.code.stroke_limit(way.acceleration, lifts)
        stroke = Stroke(v, float(taken[0]), left, before, after, limit=limit)
        if not self.planner.fixed_time:
            return stroke
        # it overshoots where the next block begins faster
        fastest = min(speed, math.sqrt(entry * entry + 2.0 * float((a * d)[0])))
        cruise = max(float((d - (v * v - entry * entry) / (2.0 * a))[0]), 0.0)
        return stroke._replace(fastest=fastest, cruise=cruise)

    def segments(self, points: Array, forced: Flags, last: bool) -> tuple[Integers, Array]:
        """Return segments on whole steps. A line of the file waits for the end of its segment."""
        in_steps = points[:, :Z] / self.code.steps.belt
        cells = np.rint(in_steps).astype(np.int64)
        apart = max(1, math.ceil(round(1.0 / (TS * USED_LINES_SHARE * self.lines_per_second), 6)))
        least, stall = self.code.table.min_steps_per_segment, round(self.planner.stall / TS)
        matrix = self.kinematics.matrix
        motors = motor_places(cells, matrix)
        ends = segment_ends(motors, least, apart, stall, last)
        ends = slow_segment_ends(in_steps, cells, motors, ends, least, apart)
        ends, vertices = with_late_starts(ends, cells, matrix, least, apart)
        at = points[ends]
        if stall and not self.code.table.classic_jerk:
            off = in_steps[np.append(0, ends)] - vertices
            vertices = without_reversals(vertices, off, matrix, least)
        at[:, :Z] = vertices[1:] * self.code.steps.belt
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

    def _block(self, way: Way) -> Blocks:
        """Return the block of a retraction or a lift."""
        return self._blocks(np.array(way[:2]), users=way.acceleration)

    def _blocks(self, at: Array, after: float = math.inf, users: float = math.inf) -> Blocks:
        """Return the blocks between places. users: acceleration, mm/s², of z, or of filament."""
        code, steps = self.code, self.code.steps
        own = code.limits.z_acceleration, code.limits.extruder_acceleration
        of_z, of_e = own if users == math.inf else (users, users)
        limits = BlockLimits(
            steps.belt, steps.z, steps.e, code.block_acceleration, of_z,
            code.filament_acceleration, of_e,
            math.inf if code.table.classic_jerk else DEVIATIONS[1],
        )  # fmt: skip
        return blocks_between(at, after, limits, self.kinematics.matrix)


# ----------------------------------------------------------------------
# Moves of one axis as Marlin plays them: whole steps and step rates, and its planner's ramps.

# With CLASSIC_JERK, planners up to 2.1 compare the speed of a block with that of the one before,
# although the faster one need not begin at its own. So M205 allows every speed, and the axis turns
# back where it is slow
REVERSAL_MM_S = 4.0  # mm/s


@dataclass(frozen=True, slots=True)
class MarlinMoves(WrittenMoves):
    """Moves as Marlin plays them."""

    code: MarlinCode
    kinematics: Kinematics = field(kw_only=True)

    @classmethod
    def on(cls, code: MarlinCode, kinematics: Kinematics) -> MarlinMoves:
        """Return the moves of a board."""
        return cls(
            code, code.steps.belt, code.table.min_steps_per_segment,
            REVERSAL_MM_S if code.table.classic_jerk else 0.0,
            ("M400", "M593 F0", code.motion_mode, TRAPEZOIDS),
            "send M501: it brings back the settings that are saved in the printer.",
            kinematics=kinematics,
        )  # fmt: skip

    def limits(self, fastest: float, acceleration: float) -> list[str]:
        v = plain(fastest, 0)
        corners = f"X{v} Y{v} E1" if self.code.table.classic_jerk else self.code.corners(False)
        return ["M400", *motion_limits(fastest, acceleration, corners)]

    def ahead(self, z: float) -> list[str]:
        return self.code.filling_lines(z)

    def speed(self, v: float) -> float:
        """Return a feed rate: Marlin rounds steps a second up, or where moves meet to the nearest.

        The development branch does the latter.
        """
        return (round(v / self.step) - 0.4) * self.step

    def motion(self, cells: Integers, v: Array, turns: Array, acceleration: float) -> Array:
        n = most_steps(motor_steps(cells, self.kinematics.matrix)).astype(np.float64)
        d, at = self._along(cells)
        blocks = Blocks(n, d, np.floor(acceleration * n / d))
        planner = self.code.planner
        return np.interp(planner.travelled(blocks, *planner.reachable(blocks, turns, v), v), *at)
