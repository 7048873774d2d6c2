"""Runs → samples: the jerk-limited profile of every run, on one clock.

Each run is planned along the path length, and x, y, z and e follow the path: extrusion stays
proportional to it. Points of rest fall on whole samples. Before and after anything that the machine
does at rest, the path may stand still for a moment in which the compensated command moves on. A
lift next to motion needs no such rest: where firmware takes the corner between them at a speed, z
does not come to rest there.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from enum import Enum, auto
from itertools import pairwise

import numpy as np

from hframe_post.arrays import TS, Array, E, Integers
from hframe_post.native.sampling import follow, path_lengths, phases, samples_until
from hframe_post.planner.profiles import Profile, Profiler, StandingProfile, TravelRetraction
from hframe_post.printer.settings import Limits
from hframe_post.stream.types import (
    Event,
    Halt,
    Handling,
    Mark,
    Passthrough,
    Pause,
    Plan,
    Planned,
    Rest,
    Rests,
    Samples,
    SlowStraight,
    Standing,
    frozen,
)

SAMPLES_PER_CHUNK = 1 << 15
RUNS_AT_ONCE = 1000  # runs whose profiles are found together
SLOW = 2.0  # mm/s at which a motion excites nothing, so that its samples can be left out
FEWEST = 2000  # samples that are left out at once
KEPT = 500  # samples at either end of a slow move that are not left out
SPARED = 0.8  # share of the firmware's corner speed that a lift counts on


def sample(
    planned: Iterable[Planned], limits: Limits, rests: Rests, size: int | None = None,
    skip_slow: bool = False,
) -> Iterator[Samples]:  # fmt: skip
    """Yield the samples of the whole stream, in chunks of about ``size`` if it is given.

    A chunk may hold several plans, and ends where the machine is released. skip_slow: leave out the
    samples of long pauses and of slow straights, so that these take no longer than short ones.
    """
    size = size or SAMPLES_PER_CHUNK
    sampler = _Sampler(limits, rests, size, skip_slow)
    for item, motion in _with_motion_after(sampler.profiled(planned), rests.needs_rest):
        if isinstance(item, Plan):
            yield from sampler.run(item)
        elif isinstance(item, Standing):
            yield from sampler.stand(item, motion)
        elif isinstance(item, Halt):
            yield from sampler.come_to_rest(aside=True)
        elif item.handling is Handling.CARRY:
            sampler.mark(item.text)
        else:
            yield from sampler.wait(item)
        if sampler.output.count >= size:  # many moves in a row while x and y stand
            yield from sampler.output.flush()
    sampler.pass_waiting_lines()
    yield from sampler.output.flush()


def _in_lists(planned: Iterable[Planned]) -> Iterator[list[Planned]]:
    items, count = list[Planned](), 0
    for item in planned:
        items.append(item)
        count += len(item.cruise) if isinstance(item, Plan) else 1
        if count >= RUNS_AT_ONCE:
            yield items
            items, count = [], 0
    yield items


def _with_motion_after(
    planned: Iterable[Planned], labels: Callable[[bytes], bool]
) -> Iterator[tuple[Planned, Plan | None]]:
    """Yield each item and, with a ``Standing``, the motion that it may pass into."""
    waiting: list[Standing | Passthrough] = []  # a Standing, and the pass-through lines after it
    for item in planned:
        carried = isinstance(item, Passthrough) and item.handling is Handling.CARRY
        if waiting and not carried:
            lines = (each.text for each in waiting if isinstance(each, Passthrough))
            free = not any(labels(text) for text in lines)
            yield waiting[0], item if free and isinstance(item, Plan) else None
            yield from ((each, None) for each in waiting[1:])
            waiting.clear()
        if isinstance(item, Standing) or (waiting and isinstance(item, Passthrough)):
            waiting.append(item)
        else:
            yield item, None
    yield from ((each, None) for each in waiting)


class _State(Enum):
    MOVING = auto()
    STOPPED = auto()  # the path stands; the command has not been given time to come to rest
    AT_REST = auto()  # so does the command, which needs time again before it sets out
    ASIDE = auto()  # the same for long, or after the machine was released


class _Output:
    """Samples and events that are not yielded yet. size: samples that make a chunk."""

    def __init__(self, size: int) -> None:
        self.size = size
        self.index = 0  # of the next sample
        self.line = 0  # source line of samples at standstill
        self.last: Array | None = None  # x, y, z, e at the last sample; None if unknown
        self.events: list[Event] = []
        self._pieces: list[tuple[Array, Integers]] = []
        self._first = 0

    @property
    def count(self) -> int:
        return self.index - self._first

    def add(self, xyze: Array, line: Integers) -> None:
        if len(xyze):
            self._pieces.append((xyze, line))
            self.index += len(xyze)
            self.last = xyze[-1]

    def stand(self, where: Array, samples: int) -> Iterator[Samples]:
        """Add standstill; yield the chunks that are full."""
        for first in range(0, samples, self.size):
            n = min(samples - first, self.size)
            xyze = np.empty((n, 4))
            xyze[:] = where
            self.add(xyze, np.full(n, self.line))
            if first + n < samples:
                yield from self.flush()

    def skip(self, where: Array, samples: int) -> Iterator[Samples]:
        """End the stretch; leave out all of these samples but the last, which is ``where``."""
        yield from self.flush(ends_stretch=True)
        self.index += samples - 1
        self._first = self.index
        self.add(np.array([where]), np.array([self.line]))

    def flush(self, ends_stretch: bool = False) -> Iterator[Samples]:
        if not self._pieces and not self.events:
            return
        nothing = np.zeros((0, 4)), np.zeros(0, dtype=np.int64)
        xyze, line = (np.concatenate(each) for each in zip(*self._pieces or [nothing], strict=True))
        first, events = self._first, tuple(self.events)
        self._pieces, self.events, self._first = [], [], self.index
        yield Samples(first, frozen(xyze), line, events, ends_stretch=ends_stretch)


class _Sampler:
    """The machine's state on the clock of samples, and what it yields."""

    def __init__(self, limits: Limits, rests: Rests, size: int, skip_slow: bool) -> None:
        self._limits, self._rests, self._skip_slow = limits, rests, skip_slow
        self._profiler = Profiler(limits.jerk, limits.deceleration)
        self._profiles: deque[Profile] = deque()  # of the next plans
        self.output = _Output(size)
        self._state = _State.ASIDE
        self._section, self._clock = 0, 0.0  # sample of the last standstill, s since then
        self._acceleration = 0.0  # of the last motion, mm/s²
        self._labelled = False  # whether a label has passed since motion last set out from rest
        self._filament_at_mark: float | None = None  # at a mark on the next sample
        self._waiting_lines: list[bytes] = []  # at the end of motion, until the command rests
        self._retraction: TravelRetraction | None = None

    @property
    def _rested(self) -> bool:
        return self._state in (_State.AT_REST, _State.ASIDE)

    # ------------------------------------------------------------------ motion

    def profiled(self, planned: Iterable[Planned]) -> Iterator[Planned]:
        """Yield the same items; find the profiles of many plans at once, ahead of ``run``."""
        for items in _in_lists(planned):
            plans = [item for item in items if isinstance(item, Plan)]
            self._profiles += self._profiler.profiles(plans)
            yield from items

    def run(self, plan: Plan) -> Iterator[Samples]:
        yield from self._set_out(plan)
        profile, at_ends = self._profiles.popleft(), plan.s[plan.ends]
        motion, self._clock = phases(*profile, plan.speed, at_ends, self._clock)
        stops = plan.speed[-1] == 0.0
        last = self._section + (
            samples_until(self._clock) if stops else math.floor(self._clock / TS)
        )
        marks, end = list(plan.marks), len(plan.line)
        self._labelled |= any(self._rests.needs_rest(mark.text) for mark in marks)
        self._acceleration = float(plan.acceleration[-1])
        if stops:
            self._waiting_lines = [mark.text for mark in marks if mark.index == end]
            marks = [mark for mark in marks if mark.index < end]
        slow = self._slow_parts(plan, motion, last)
        while (first := self.output.index) <= last:
            n = min(self.output.size, last + 1 - first)
            if slow and first == slow[0][0]:
                yield from self._straight(plan, motion, *slow.popleft())
                continue
            n = min(n, slow[0][0] - first) if slow else n
            arrives = stops and first + n > last
            s = path_lengths(motion, first - self._section, n, float(plan.s[-1]))
            if arrives:
                s[-1] = plan.s[-1]
            xyze, move = follow(plan.s, plan.points, s)
            if self._filament_at_mark is not None:
                xyze[0, E], self._filament_at_mark = self._filament_at_mark, None
            marks = self._pin(plan, marks, s, xyze)
            if arrives:
                xyze[-1] = plan.points[-1]
            if self._retraction is not None:
                xyze[:, E] += self._retraction.remaining(n)
                self._retraction = None if self._retraction.finished else self._retraction
            self.output.add(xyze, plan.line[move])
            if self.output.count >= self.output.size:
                yield from self.output.flush()
        for mark in marks:  # between the last sample of this plan and the first of the next
            self.output.events.append(Mark(self.output.index, mark.text))
            self._filament_at_mark = float(plan.points[mark.index, E])
        self._state = _State.STOPPED if stops else _State.MOVING

    def _slow_parts(self, plan: Plan, motion: Array, last: int) -> deque[tuple[int, int]]:
        """Return the samples, first and last, that can be left out of slow straights."""
        parts = deque[tuple[int, int]]()
        time, duration, s, v, a, j = motion
        steady = (v <= SLOW) & (a == 0.0) & (j == 0.0)
        phases = np.flatnonzero(steady & (duration > (FEWEST + 2 * KEPT) * TS))
        if not self._skip_slow or self._retraction is not None or not len(phases):
            return parts
        for k in phases.tolist():
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
        (before, after), (_, move) = follow(plan.s, plan.points, path)
        x, y, z, e = before.tolist()
        self.output.line = int(plan.line[move])
        self.output.events.append(SlowStraight(first, last - first + 1, (x, y, z, e)))
        yield from self.output.skip(after, last - first + 2)

    def _set_out(self, plan: Plan) -> Iterator[Samples]:
        self.output.line = int(plan.line[0])
        self.pass_waiting_lines()
        if self.output.last is None:
            yield from self.output.stand(plan.points[0], 1)  # from where the motion starts
        if self._rested:
            self._labelled = False
            aside = self._state is _State.ASIDE
            yield from self._rest(
                plan.points[0], self._rests.long_rest if aside else self._rests.after
            )
        if self._state is not _State.MOVING:
            self._section, self._clock = self.output.index - 1, 0.0
            self._state = _State.MOVING

    def _pin(self, plan: Plan, marks: list[Mark], s: Array, xyze: Array) -> list[Mark]:
        """Put marks on the first sample at or after their vertex; return those that lie beyond.

        They get the vertex's filament, so that what is extruded between two marks is exact.
        """
        if not marks:
            return marks
        vertices = np.array([mark.index for mark in marks], dtype=np.int64)
        rows = np.searchsorted(s, plan.s[vertices])
        here = int(np.searchsorted(rows, len(s)))
        xyze[rows[:here], E] = plan.points[vertices[:here], E]
        self.output.events += [
            Mark(self.output.index + row, mark.text)
            for row, mark in zip(rows[:here].tolist(), marks, strict=False)
        ]
        return marks[here:]

    # ------------------------------------------------------------------ rest

    def mark(self, text: bytes) -> None:
        self._labelled |= self._rests.needs_rest(text)
        if self._waiting_lines:
            self._waiting_lines.append(text)
        else:
            self.output.events.append(Mark(self.output.index, text))

    def wait(self, action: Passthrough) -> Iterator[Samples]:
        self._labelled |= self._rests.needs_rest(action.text)
        released = action.handling is Handling.RELEASE
        n, out = samples_until(action.seconds), self.output
        yield from self.come_to_rest(released or n >= self._rests.long_from)
        out.line = action.line
        if out.last is None:  # nothing to sample where the position is unknown
            out.events.append(Pause(out.index, 0, action))
        else:
            out.events.append(Pause(out.index, n, action, action.seconds))
            if self._skip_slow and n >= FEWEST:
                yield from out.skip(out.last, n)
            else:
                yield from out.stand(out.last, n)
        if released:
            yield from out.flush(ends_stretch=True)
            out.last = None

    def stand(self, move: Standing, motion: Plan | None) -> Iterator[Samples]:
        """Add a retraction or a lift. motion: what it may pass into without rest."""
        out = self.output
        if out.last is None:
            yield from out.stand(np.array(move.start), 1)
        if motion is not None and self._rests.retract_acceleration and not self._rested:
            moving = TravelRetraction.if_it_fits(
                move, motion, self._limits, self._rests.retract_acceleration
            )
            if moving is not None:
                self._retraction = moving
                return
        entry = leaving = 0.0
        if not self._rested:
            entry = self._corner_speed(self._acceleration)
        if motion is not None and not self._labelled and self._state is not _State.ASIDE:
            leaving = self._corner_speed(float(motion.acceleration[0]))
        profile = StandingProfile.from_move(move, self._limits, entry, leaving)
        if long := profile.samples >= self._rests.long_from:
            profile = StandingProfile.from_move(move, self._limits)
        entry, leaving = profile.trapezoid.v_s, profile.trapezoid.v_e
        exact = profile.trapezoid.seconds
        yield from self.come_to_rest(long, needed=entry == 0.0)
        out.line = move.line
        out.events.append(Pause(out.index, profile.samples, move, exact, entry, leaving))
        if self._skip_slow and profile.samples >= FEWEST and not (entry or leaving):
            yield from out.skip(profile.places(move, profile.samples, 1)[0], profile.samples)
            self._state = _State.ASIDE
            return
        for first in range(0, profile.samples, out.size):
            n = min(profile.samples - first, out.size)
            out.add(profile.places(move, first + 1, n), np.full(n, move.line))
            if first + n < profile.samples:
                yield from out.flush()
        if leaving:
            self._state = _State.STOPPED

    def _corner_speed(self, acceleration: float) -> float:
        """Return the speed, mm/s, of z between a lift and motion at an acceleration."""
        # the motion's first segment is some 10 µm long and limits it to 0.05·√(mm/s²)
        return min(SPARED * self._rests.lift_speed, 0.05 * math.sqrt(acceleration))

    def come_to_rest(self, aside: bool, needed: bool = True) -> Iterator[Samples]:
        """Give the command time to come to rest if that is needed and it has had none."""
        if needed and not self._rested and self.output.last is not None:
            samples = self._rests.long_rest if aside else self._rests.before
            yield from self._rest(self.output.last, samples)
        self.pass_waiting_lines()
        aside = aside or self._state is _State.ASIDE
        self._state = _State.ASIDE if aside else _State.AT_REST

    def _rest(self, where: Array, samples: int) -> Iterator[Samples]:
        if samples:
            self.output.events.append(Rest(self.output.index, samples))
            yield from self.output.stand(where, samples)

    def pass_waiting_lines(self) -> None:
        """Add the lines that waited for the command to come to rest."""
        self.output.events += [Mark(self.output.index, text) for text in self._waiting_lines]
        self._waiting_lines = []
