"""Runs → samples: the jerk-limited profile of every run, on one clock.

Each run is planned along the path length, and x, y, z and e follow the path: extrusion stays
proportional to it. Points of rest fall on whole samples. Before and after anything that the machine
does while the command dwells, the path may rest for a moment in which the command moves on. A lift
next to motion needs no such rest: where firmware takes the corner between them at a speed, z does
not come to rest there. ``stopping`` has the states of a stop.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Iterator
from itertools import pairwise

import numpy as np

from hframe_post.arrays import TS, Array, E
from hframe_post.native.planning import follow, path_lengths, phases, samples_until
from hframe_post.planner.output import Output
from hframe_post.planner.profiles import Profile, ProfileAtRest, Profiler
from hframe_post.planner.stopping import State, Stopping
from hframe_post.printer.settings import Limits
from hframe_post.stream.marks import Marks
from hframe_post.stream.types import (
    Dwell,
    Handling,
    MoveAtRest,
    Passthrough,
    Plan,
    Planned,
    Rest,
    Samples,
    SlowStraight,
    SpanEnd,
    StopRules,
)

SAMPLES_PER_CHUNK = 1 << 14  # half as many take 8 % more CPU, twice as many 20 MB more
FEWEST = 2000  # samples that are left out at once
KEPT = 500  # samples at either end of a slow move that are not left out
SPARED = 0.8  # share of the firmware's corner speed that a lift counts on


def sample(
    planned: Iterable[Planned], limits: Limits, rules: StopRules, size: int | None = None,
    skip_slow: bool = False,
) -> Iterator[Samples]:  # fmt: skip
    """Yield the samples of the whole stream, in chunks of about ``size`` if it is given.

    A chunk may hold several plans, and ends where the machine is released. skip_slow: leave out the
    samples of long dwells and of slow straights, so that these take no longer than short ones.
    """
    size = size or SAMPLES_PER_CHUNK
    sampler = _Sampler(limits, rules, size, skip_slow)
    for item, motion in _with_motion_after(sampler.profiled(planned)):
        if isinstance(item, Plan):
            yield from sampler.run(item)
        elif isinstance(item, MoveAtRest):
            yield from sampler.move_at_rest(item, motion)
        elif isinstance(item, SpanEnd):
            sampler.come_to_rest(apart=True)
        elif isinstance(item, Marks):
            sampler.mark(item)
        else:
            yield from sampler.dwell(item)
        if sampler.output.count >= size:  # many moves in a row at rest
            yield from sampler.output.flush()
    sampler.pass_waiting_lines()
    yield from sampler.output.flush()


def _in_lists(planned: Iterable[Planned]) -> Iterator[list[Planned]]:
    """Yield the items in lists of a thousand runs or more, whose profiles are found together."""
    items, count = list[Planned](), 0
    for item in planned:
        items.append(item)
        count += len(item.cruise) if isinstance(item, Plan) else 1
        if count >= 1000:
            yield items
            items, count = [], 0
    yield items


def _with_motion_after(planned: Iterable[Planned]) -> Iterator[tuple[Planned, Plan | None]]:
    """Yield each item and, with a ``MoveAtRest``, the motion that it may pass into."""
    waiting: list[MoveAtRest | Marks] = []  # a move at rest, and the lines after it
    for item in planned:
        if waiting and not isinstance(item, Marks):
            yield waiting[0], item if isinstance(item, Plan) else None
            yield from ((each, None) for each in waiting[1:])
            waiting.clear()
        if isinstance(item, MoveAtRest) or (waiting and isinstance(item, Marks)):
            waiting.append(item)
        else:
            yield item, None
    yield from ((each, None) for each in waiting)


class _Sampler:
    """The machine on the clock of samples, and what it yields."""

    def __init__(self, limits: Limits, rules: StopRules, size: int, skip_slow: bool) -> None:
        self._limits, self._rules, self._skip_slow = limits, rules, skip_slow
        self._profiler = Profiler(limits.jerk)
        self._profiles: deque[Profile] = deque()  # of the next plans
        self.output = Output(size)
        self._stopping = Stopping(rules)
        self._section, self._clock = 0, 0.0  # sample of the last stop, s since then
        self._acceleration = 0.0  # of the last motion, mm/s²
        self._filament_at_mark: float | None = None  # at a mark on the next sample
        self._waiting_lines: list[Marks] = []  # at the end of motion, until the command rests

    # ------------------------------------------------------------------ motion

    def profiled(self, planned: Iterable[Planned]) -> Iterator[Planned]:
        """Yield the same items; find the profiles of many plans at once, ahead of ``run``."""
        for items in _in_lists(planned):
            plans = [item for item in items if isinstance(item, Plan)]
            self._profiles += self._profiler.profiles(plans)
            yield from items

    def run(self, plan: Plan) -> Iterator[Samples]:
        self._set_out(plan)
        profile, at_ends = self._profiles.popleft(), plan.s[plan.ends]
        motion, end = phases(*profile, plan.speed, at_ends, self._clock)
        self._clock = float(end[0])
        stops = plan.rests or plan.speed[-1] == 0.0
        since = samples_until(self._clock) if stops else math.floor(self._clock / TS)
        last, marks = self._section + since, plan.marks
        if stops:
            passed = marks.count_before(len(plan.line))
            self._waiting_lines = [marks.rows(passed)] if passed < len(marks) else []
            marks = marks.rows(0, passed)
        slow = self._slow_parts(plan, motion, last)
        while (first := self.output.index) <= last:
            if slow and first == slow[0][0]:
                yield from self._straight(plan, motion, *slow.popleft())
                continue
            n = min(self.output.size, last + 1 - first)
            n = min(n, slow[0][0] - first) if slow else n
            marks = self._follow(plan, motion, marks, n, stops and first + n > last)
            if self.output.count >= self.output.size:
                yield from self.output.flush()
        if marks:  # between the last sample of this plan and the first of the next
            self.output.mark(marks)
            self._filament_at_mark = float(plan.points[marks.last, E])
        if stops:
            self._stopping.stop()

    def _set_out(self, plan: Plan) -> None:
        out, stopping = self.output, self._stopping
        out.line = int(plan.line[0])
        self.pass_waiting_lines()
        if out.last is None:
            out.rest(plan.points[0], 1)  # from where the motion starts
        moved = stopping.state is State.MOVING
        self._rest(plan.points[0], stopping.move())
        if not moved:
            self._section, self._clock = out.index - 1, 0.0
        self._acceleration = float(plan.acceleration[-1])

    def _follow(self, plan: Plan, motion: Array, marks: Marks, n: int, arrives: bool) -> Marks:
        """Add the next n samples along the path; return the marks that lie beyond them."""
        s = path_lengths(motion, self.output.index - self._section, n, float(plan.s[-1]))
        if arrives:
            s[-1] = plan.s[-1]
        index = self.output.index
        xyze, line = self.output.room(n)
        follow(plan.s, plan.points, plan.line, s, xyze, line)
        if self._filament_at_mark is not None:
            xyze[0, E], self._filament_at_mark = self._filament_at_mark, None
        marks = self._pin(plan, marks, s, xyze, index)
        if arrives:
            xyze[-1] = plan.points[-1]
        return marks

    def _slow_parts(self, plan: Plan, motion: Array, last: int) -> deque[tuple[int, int]]:
        """Return the samples, first and last, that can be left out of slow straights."""
        parts, least = deque[tuple[int, int]](), (FEWEST + 2 * KEPT) * TS
        time, duration, s, v, a, j = motion
        if not self._skip_slow or duration.max() <= least:
            return parts
        long = np.flatnonzero(duration > least)
        # mm/s at which a motion excites nothing
        for k in long[(v[long] <= 2.0) & (a[long] == 0.0) & (j[long] == 0.0)].tolist():
            end = s[k] + v[k] * duration[k]
            inside = plan.s[(plan.s > s[k]) & (plan.s < end)]
            passed = time[k] + (np.concatenate([[s[k]], inside, [end]]) - s[k]) / v[k]
            for begin, until in pairwise((passed / TS).tolist()):
                first = self._section + math.ceil(begin) + KEPT
                final = min(self._section + math.floor(until), last) - KEPT
                if first >= self.output.index and final - first >= FEWEST:
                    parts.append((first, final))
        return parts

    def _straight(self, plan: Plan, motion: Array, first: int, last: int) -> Iterator[Samples]:
        """Leave out samples first … last, which go straight; end the stretch before them."""
        path = path_lengths(motion, last - self._section, 2, float(plan.s[-1]))
        places, lines = np.empty((2, 4)), np.empty(2, np.int64)
        follow(plan.s, plan.points, plan.line, path, places, lines)
        x, y, z, e = places[0].tolist()
        self.output.line = int(lines[1])
        self.output.events.append(SlowStraight(first, last - first + 1, (x, y, z, e)))
        yield from self.output.skip(places[1], last - first + 2)

    def _pin(self, plan: Plan, marks: Marks, s: Array, xyze: Array, index: int) -> Marks:
        """Put marks on the first sample at or after their vertex; return those that lie beyond.

        They get the vertex's filament, so that what is extruded between two marks is exact. index:
        of the first of the samples xyze (n, 4), at path lengths s (n,).
        """
        if not marks:
            return marks
        rows = np.searchsorted(s, plan.s[marks.at])
        here = int(np.searchsorted(rows, len(s)))
        if here:
            passed, rows = marks.rows(0, here), rows[:here]
            xyze[rows, E] = plan.points[passed.at, E]
            self.output.events.append(passed.moved_to(index + rows))
        return marks.rows(here)

    # ------------------------------------------------------------------ at rest

    def mark(self, lines: Marks) -> None:
        if self._stopping.state is State.STOPPED:
            self._waiting_lines.append(lines)
        else:
            self.output.mark(lines)

    def dwell(self, action: Passthrough) -> Iterator[Samples]:
        """Add what the machine does at a line while the command dwells."""
        released = action.handling is Handling.RELEASE
        n, out = samples_until(action.seconds), self.output
        apart = (released and action.end is None) or n >= self._rules.long_from
        self.come_to_rest(apart)
        out.line = action.line
        if out.last is None:  # nothing to sample where the position is unknown
            out.events.append(Dwell(out.index, 0, action))
        else:
            out.events.append(Dwell(out.index, n, action, action.seconds))
            if self._skip_slow and n >= FEWEST:
                yield from out.skip(out.last, n)
                n = 0
            for left in range(n, 0, -out.size):
                out.rest(out.last, min(left, out.size))
                if left > out.size:
                    yield from out.flush()
        if released:
            yield from out.flush(ends_stretch=True)
            out.last = None

    def move_at_rest(self, move: MoveAtRest, motion: Plan | None) -> Iterator[Samples]:
        """Add a retraction or a lift. motion: what it may pass into without rest."""
        out = self.output
        if out.last is None:
            out.rest(np.array(move.start), 1)
        planned = move.entry, move.leaving
        at_ends = planned if any(planned) else self._corner_speeds(motion)
        profile = ProfileAtRest.from_move(move, self._limits, *at_ends)
        if long := profile.samples >= self._rules.long_from:
            profile = ProfileAtRest.from_move(move, self._limits, *planned)
        n, way = profile.samples, profile.trapezoid
        if way.v_s and not any(planned):
            self._stopping.enter()
            self.pass_waiting_lines()
        else:
            self.come_to_rest(long)
        out.line = move.line
        out.events.append(Dwell(out.index, n, move, way.seconds, way.v_s, way.v_e))
        if self._skip_slow and n >= FEWEST and not (way.v_s or way.v_e):
            end = np.empty((1, 4))
            profile.fill(move, n, end)
            yield from out.skip(end[0], n)
            self.come_to_rest(apart=True)
            return
        for first in range(0, n, out.size):
            count = min(n - first, out.size)
            xyze, line = out.room(count)
            profile.fill(move, first + 1, xyze)
            line[:] = move.line
            if first + count < n:
                yield from out.flush()
        if way.v_e and not any(planned):
            self._stopping.leave()

    def _corner_speeds(self, motion: Plan | None) -> tuple[float, float]:
        """Return z's greatest speeds, mm/s, next to the motion before and after a lift."""
        entry = leaving = 0.0
        if not self._stopping.settled:
            entry = self._corner_speed(self._acceleration)
        if motion is not None and self._stopping.state is not State.APART:
            leaving = self._corner_speed(float(motion.acceleration[0]))
        return entry, leaving

    def _corner_speed(self, acceleration: float) -> float:
        """Return the speed, mm/s, of z between a lift and motion at an acceleration."""
        # the motion's first segment is some 10 µm long and limits it to 0.05·√(mm/s²)
        return min(SPARED * self._rules.lift_speed, 0.05 * math.sqrt(acceleration))

    def come_to_rest(self, apart: bool) -> None:
        """Give the command time to settle if it has had none."""
        if samples := self._stopping.dwell(apart):
            assert self.output.last is not None
            self._rest(self.output.last, samples)
        self.pass_waiting_lines()

    def _rest(self, where: Array, samples: int) -> None:
        if samples:
            self.output.events.append(Rest(self.output.index, samples))
            self.output.rest(where, samples)

    def pass_waiting_lines(self) -> None:
        """Add the lines that waited for the command to come to rest."""
        for lines in self._waiting_lines:
            self.output.mark(lines)
        self._waiting_lines = []
