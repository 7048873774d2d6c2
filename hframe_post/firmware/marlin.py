"""What Marlin does with a stream: whole steps, ramps of whole steps, its limits, its commands.

1. Coordinates are rounded to whole steps of x and of y; belt motors then make x ± y of them.
2. A block in which no motor makes MIN_STEPS_PER_SEGMENT steps joins the next and moves at
   its speed. Segments are therefore long enough, and end on whole steps.
3. The motor with the most steps sets the pace: whole steps per second, whole ticks of a timer
   per step. The first step of a block is made at the speed at which the block begins.
4. When the queue runs empty, Marlin waits 0.1 s before it goes on. So nothing waits: what
   the command spends standing still, if no line of the file asks for it, is left out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hframe_post.arrays import TS, Array, E, Flags, Integers, Z
from hframe_post.errors import PrinterError
from hframe_post.firmware import ramps
from hframe_post.firmware.player import Dwelling, coordinates, plain
from hframe_post.model.kinematics import Kinematics
from hframe_post.printer.firmware_tables import MarlinTable
from hframe_post.printer.settings import Limits, Motors, Printer, Steps
from hframe_post.stream.types import ModalState

HEADROOM = 2.0  # times the motors' acceleration; ramps last a step or two
VELOCITY_HEADROOM = 1.1
JUNCTION_DEVIATION = 0.3  # mm, the most that M205 takes; corners are the stream's business
JERK, JERK_E = 100.0, 50.0  # mm/s, the same where CLASSIC_JERK is built
MARGIN = 6  # steps of a segment beyond the least, if the command does not stop there
IDLE = 24  # samples without a step that are a standstill
SLOWEST = 120  # steps per second below which no ramp begins or ends
GOLDEN = (5.0**0.5 - 1.0) / 2.0  # its multiples fall evenly between whole numbers
FASTEST = 3.0  # times a segment's mean speed, asked for to make up for its ramps
MOST_LOST = 0.01  # share of time that rounding can lose
ROUNDS = 3  # of the rates' dependence on their neighbours'


@dataclass(frozen=True, slots=True)
class Marlin:
    """Marlin as a ``Player``. Lengths mm; rates are steps per second of the leading motor."""

    own: MarlinTable
    limits: Limits
    motors: Motors
    steps: Steps
    kinematics: Kinematics

    @classmethod
    def of(cls, printer: Printer, tolerance: float | None = None) -> Marlin:
        """As that printer has it. Raises PrinterError where its profile does not know Marlin.

        tolerance: of no meaning, segments are as long as whole steps make them.
        """
        own, steps = printer.firmware.marlin, printer.steps
        if own is None or steps is None:
            key = "steps" if own else "firmware.marlin"
            raise PrinterError("the table is missing: Marlin needs it", key, printer.name)
        return cls(own, printer.limits, printer.motors, steps, printer.kinematics)

    @property
    def lines_per_second(self) -> float:
        """See ``Player``, as all of these."""
        return self.own.lines_per_second

    # ------------------------------------------------------------------ commands

    def begin(self, offset: tuple[float, float, float], at: Array) -> list[bytes]:
        """Shaping, linear advance and fixed-time motion go off, limits up."""
        a, v = plain(self._acceleration, 0), plain(self._velocity, 0)
        start = [
            "M400", "M593 F0", "M900 K0", "M493 S0", f"M201 X{a} Y{a}", f"M203 X{v} Y{v}",
            f"M204 P{a} T{a}", f"M205 B0 S0 T0 {self._corners(False)}",
        ]  # fmt: skip
        return [line.encode() for line in [*start, "G90", "M83", *coordinates(offset, at)]]

    def end(self, state: ModalState, at: Array) -> list[bytes]:
        """Shaping, linear advance and fixed-time motion only if the profile knows of them."""
        own = self.own
        velocity, acceleration = (
            f"X{plain(x, 3)} Y{plain(y, 3)}" for x, y in (own.max_velocity, own.max_acceleration)
        )
        least = f"S{plain(own.min_velocity, 3)} T{plain(own.min_travel_velocity, 3)}"
        lines = [
            "M400", f"M201 {acceleration}", f"M203 {velocity}",
            f"M204 P{plain(own.acceleration, 3)} T{plain(own.travel_acceleration, 3)}",
            f"M205 B{plain(own.min_segment_time * 1e6, 0)} {least} {self._corners(True)}",
        ]  # fmt: skip
        if own.linear_advance:
            lines.append(f"M900 K{plain(own.linear_advance, 5)}")
        for axis, frequency in (("X", own.shaper_freq_x), ("Y", own.shaper_freq_y)):
            if frequency:
                lines.append(f"M593 {axis} F{plain(frequency, 3)}")
        if own.fixed_time_motion:
            lines.append(f"M493 S{own.fixed_time_motion}")
        lines += [
            *coordinates(state.offset, at[:E] - state.offset),
            f"G1 F{plain(state.feed * 60, 1)}",
        ]
        if not state.absolute:
            lines.append("G91")  # before M82: it is for E, too
        if state.absolute_e:
            lines += ["M82", f"G92 E{plain(state.e, 5)}"]
        return [line.encode() for line in lines]

    def modes_after(self, name: str) -> bytes:
        """G90 and G91 are for E, too; linear advance stays off."""
        modes = {"G90": b"M83\n", "G91": b"G90\nM83\n", "M82": b"M83\n", "M900": b"M900 K0\n"}
        return modes.get(name, b"")

    def reset_extruder(self) -> bytes:
        """Marlin counts in floats, which forget the smallest moves when they have grown."""
        return b"G92 E0\n"

    def dwell(self, seconds: float, beside: Dwelling) -> tuple[bytes, float] | None:
        """None is made, nor made up for; beside lifts, corners are the user's."""
        line = b""
        if beside is not Dwelling.MOTION and not self.own.classic_jerk:
            line = b"M205 %s\n" % self._corners(users=beside is Dwelling.BEFORE_LIFT).encode()
        return line, seconds

    def _corners(self, users: bool) -> str:
        """Words of M205 that set what corners may do."""
        own = self.own
        if not own.classic_jerk:
            return f"J{plain(own.junction_deviation if users else JUNCTION_DEVIATION, 4)}"
        x, y, e = (*own.jerk, own.jerk_e) if users else (JERK, JERK, JERK_E)
        return f"X{plain(x, 3)} Y{plain(y, 3)} E{plain(e, 3)}"

    @property
    def _acceleration(self) -> float:
        return HEADROOM * self.motors.belt_acceleration

    @property
    def _velocity(self) -> float:
        return VELOCITY_HEADROOM * self.motors.belt_velocity

    # ------------------------------------------------------------------ segments

    def segments(self, points: Array, forced: Flags, last: bool) -> tuple[Integers, Array]:
        """Lines of the file wait for the end of a segment: nothing is forced."""
        cells = np.rint(points[:, :Z] / self.steps.belt).astype(np.int64)
        motors = self._motors(cells)
        least, n = self.own.min_steps_per_segment, len(points) - 1
        path = np.concatenate([[0], np.cumsum(_most(np.diff(motors, axis=0)))])
        apart = max(1, int(np.ceil(round(1.0 / (TS * self.own.lines_per_second), 6))))
        following = np.searchsorted(path, path + least + MARGIN)
        following = np.maximum(following, np.arange(n + 1) + apart)
        stops = np.append(_idle_edges(path), n)
        index = np.minimum(np.searchsorted(stops, np.arange(n + 1), side="right"), len(stops) - 1)
        ends = _long_enough(_chain(np.minimum(following, stops[index])), motors, least, last)
        at = points[ends]
        at[:, :Z] = cells[ends] * self.steps.belt
        return ends, at

    def _motors(self, cells: Integers) -> Integers:
        """Steps of the two motors (n, 2) at steps of x and y (n, 2)."""
        return np.asarray(cells @ self.kinematics.matrix.astype(np.int64).T)

    # ------------------------------------------------------------------ feed rates

    def least_times(self, at: Array, T: Array) -> Array:
        """No longer than the slowest steps take."""
        return np.minimum(T, self._counts(at)[0] / SLOWEST)

    def feed_rates(self, at: Array, T: Array, rest: Flags, before: float) -> Array:
        """Speeds that Marlin rounds up to the wanted whole steps per second."""
        n, d, _ = self._counts(at)
        rate, lost = n / T, 0.0
        for _ in range(ROUNDS):  # rounding makes ramps of its own, which lose time
            for _ in range(ROUNDS):
                rate *= self._taken(at, rate, before, exact=False) / (T * (1.0 - lost))
                rate = np.clip(rate, n / T / FASTEST, n / T * FASTEST)  # ramps may be too long
            whole = self._whole(rate)
            lost += float((self._taken(at, whole, before) - T).sum() / T.sum())
            lost = min(max(lost, -MOST_LOST), MOST_LOST)
        return np.asarray((whole - 0.5) * d / n)

    def _whole(self, rate: Array) -> Array:
        """Whole rates (k,) of whole ticks, above and below rates (k,) so that none adds up."""
        threshold = np.modf(GOLDEN * np.arange(1, len(rate) + 1))[0]
        ticks = np.floor(self.own.timer_hz / rate + threshold)
        slow = rate * rate < self.own.timer_hz
        whole = np.floor(np.where(slow, rate + threshold, self.own.timer_hz / ticks))
        return np.asarray(np.maximum(whole, 1.0))

    def durations(self, at: Array, v: Array, rest: Flags, before: float) -> Array:
        """Ramps and rounding in mind; when a block begins at rest is not known, nor needed."""
        n, d, _ = self._counts(at)
        return self._taken(at, np.ceil(v * n / d), before)

    def _counts(self, at: Array) -> tuple[Array, Array, Array]:
        """Steps of the leading motor (k,), length (k,), its acceleration (k,), steps/s²."""
        cells = np.rint(at[:, :Z] / self.steps.belt).astype(np.int64)
        xy = _most(np.diff(self._motors(cells), axis=0))
        z, e = (np.abs(np.diff(np.rint(at[:, axis] / mm)))
                for axis, mm in ((Z, self.steps.z), (E, self.steps.e)))  # fmt: skip
        n = np.maximum.reduce([xy, z, e, np.ones(len(xy))])
        moved = np.diff(at[:, :E], axis=0)
        moved[:, :Z] = np.diff(cells, axis=0) * self.steps.belt
        d = np.sqrt(np.square(moved).sum(axis=1))
        with np.errstate(divide="ignore"):
            a = np.minimum(
                self.limits.z_acceleration / self.steps.z * n / z,
                self.limits.extruder_acceleration / self.steps.e * n / e,
            )
        return (
            n,
            np.maximum(d, self.steps.belt),
            np.minimum(a, self._acceleration / self.steps.belt),
        )

    def _taken(self, at: Array, rate: Array, before: float, exact: bool = True) -> Array:
        """Time (k,) of blocks at rates (k,); exact: in whole ticks of the stepping timer."""
        n, d, a = self._counts(at)
        v = rate * d / n
        free = np.full(len(v) + 1, np.inf)
        v_s, v_e = ramps.ends(v, free, before or v[0])
        begin, end = (np.maximum(np.rint(w * n / d), SLOWEST) for w in (v_s, v_e))
        begin, end = np.minimum(begin, rate), np.minimum(end, rate)
        up = np.ceil((rate**2 - begin**2) / (2.0 * a))
        down = np.floor((rate**2 - end**2) / (2.0 * a))
        meet = np.clip(np.ceil((end**2 - begin**2 + 2.0 * a * n) / (4.0 * a)), 0.0, n)
        short = up + down > n
        up, down = np.where(short, meet, up), np.where(short, n - meet, down)
        rising, falling = np.minimum(up, n - 1), np.maximum(down - 1, 0)
        hz = self.own.timer_hz if exact else np.inf
        climb, top = _climb(begin, rate, a, rising, hz)
        fall = _fall(top, end, a, falling, hz)
        cruise = np.maximum(n - 1 - rising - falling, 0.0) * _interval(rate, hz)
        return np.asarray(_interval(begin, hz) + climb + cruise + fall)


def _climb(begin: Array, rate: Array, a: Array, steps: Array, hz: float) -> tuple[Array, Array]:
    """Time (k,) of the steps in which speed rises, and the rate reached."""
    t, now = np.zeros(len(steps)), begin
    for k in range(int(steps.max(initial=0.0))):
        now = np.where(k < steps, np.minimum(begin + a * t, rate), now)
        t = np.where(k < steps, t + _interval(now, hz), t)
    return t, np.where(steps > 0, now, rate)


def _fall(top: Array, end: Array, a: Array, steps: Array, hz: float) -> Array:
    """Time (k,) of the steps in which speed falls."""
    t = np.zeros(len(steps))
    for k in range(int(steps.max(initial=0.0))):
        t = np.where(k < steps, t + _interval(np.maximum(top - a * t, end), hz), t)
    return t


def _interval(rate: Array, hz: float) -> Array:
    """Time from step to step, s, in whole ticks of a timer unless hz is infinite."""
    return np.asarray(1.0 / rate if np.isinf(hz) else np.floor(hz / rate) / hz)


def _most(steps: Integers) -> Integers:
    """Steps of the motor that makes most of them, (n,) of (n, 2)."""
    return np.asarray(np.abs(steps).max(axis=1))


def _idle_edges(path: Integers) -> Integers:
    """First and last points of runs in which no motor steps for long, ascending."""
    changes = np.flatnonzero(np.diff(path)) + 1
    first, after = np.append(0, changes), np.append(changes, len(path))
    idle = after - first > IDLE
    return np.unique(np.stack([first[idle], after[idle] - 1]))


def _chain(following: Integers) -> Integers:
    """The points that 0 leads to when each leads to a later one, and the last to itself.

    Steps of 1, 2, 4, … at once: all that are reached by one are reached, twice as far.
    """
    reached = np.zeros(len(following), dtype=bool)
    reached[0] = True
    for _ in range(len(following).bit_length()):
        reached[following[reached]] = True
        following = following[following]
    return np.flatnonzero(reached)[1:]


def _long_enough(ends: Integers, motors: Integers, least: int, last: bool) -> Integers:
    """Ends without those of too few steps: these join the segment before, or after standstill.

    last: the last end stays in any case, and takes the standstill before it along.
    """
    while True:
        steps = _most(np.diff(motors[np.append(0, ends)], axis=0))
        small = (steps > 0) & (steps < least)
        small[1:] &= ~small[:-1]
        j = np.flatnonzero(small)
        backwards = (j > 0) & ((steps[j - 1] >= least) | (last & (j == len(ends) - 1)))
        drop = np.where(backwards, j - 1, j)
        if last:
            drop = drop[drop < len(ends) - 1]
        if not len(drop):
            return ends
        ends = np.delete(ends, drop)
