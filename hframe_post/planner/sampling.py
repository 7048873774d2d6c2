"""Runs → samples: Ruckig's jerk-limited profile of every run, on one clock.

Each run is planned along the path length, from speed to speed at zero acceleration, and x,
y, z and e follow the path: extrusion stays proportional to it. Points of rest fall on whole
samples. Before and after anything that the machine does at rest there may be a little standstill
in which the compensated command moves on. A lift next to motion needs none, and where firmware
takes the corner between them at a speed, z does not come to rest there.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator

import numpy as np

from hframe_post.arrays import TS, Array, E, Integers, Z
from hframe_post.model.trapezoid import Trapezoid
from hframe_post.native.kernels import kernel
from hframe_post.planner.jerk_profile import Phases, Profiler, before_each, integrated
from hframe_post.planner.standing import ON_TIME, StandingProfile
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
    Standing,
    frozen,
)

SAMPLES_PER_CHUNK = 1 << 15
SURELY_HAD = 0.05  # mm/s for √(mm/s²): hardly slower is a first segment, which is some 10 µm long
SPARED = 0.8  # share of a corner's speed that is counted on


def sample(planned: Iterable[Planned], limits: Limits, rests: Rests) -> Iterator[Samples]:
    """Samples of the whole stream. A chunk ends where the machine is released."""
    sampler = _Sampler(limits, rests)
    for item, motion in _with_motion_after(planned, rests.labels):
        if isinstance(item, Plan):
            yield from sampler.run(item)
        elif isinstance(item, Passthrough) and item.handling is Handling.CARRY:
            sampler.mark(item.text)
        elif isinstance(item, Halt):
            yield from sampler.halt()
        else:
            yield from sampler.pause(item, motion)
        if sampler.held >= SAMPLES_PER_CHUNK:  # many moves in a row beside x and y
            yield from sampler.flush()
    yield from sampler.finish()


def _with_motion_after(
    planned: Iterable[Planned], labels: Callable[[bytes], bool]
) -> Iterator[tuple[Planned, Plan | None]]:
    """Each item, and of a ``Standing`` the motion that it may pass into."""
    held: list[Standing | Passthrough] = []  # a Standing, and the lines carried after it
    for item in planned:
        carried = isinstance(item, Passthrough) and item.handling is Handling.CARRY
        if held and not carried:
            lines = (each.text for each in held if isinstance(each, Passthrough))
            free = not any(labels(text) for text in lines)
            yield held[0], item if free and isinstance(item, Plan) else None
            yield from ((each, None) for each in held[1:])
            held.clear()
        if isinstance(item, Standing) or (held and isinstance(item, Passthrough)):
            held.append(item)
        else:
            yield item, None
    yield from ((each, None) for each in held)


class _Sampler:
    """The clock: next sample, where it stands, and the time since the last rest."""

    def __init__(self, limits: Limits, rests: Rests) -> None:
        self._limits, self._rests = limits, rests
        self._profiler = Profiler()
        self._index = 0  # of the next sample
        self._moving = False
        self._rested = True  # the machine stands, and has not been given the time to begin
        self._aside = True  # for long, or in other hands
        self._section, self._clock = 0, 0.0  # sample of the last rest, s since then
        self._last: Array | None = None  # x, y, z, e at the last sample
        self._pinned: float | None = None  # filament at a mark on the next sample
        self._line = 0
        self._acceleration = 0.0  # of the last motion, mm/s²
        self._labelled = False  # since motion last set out from rest
        self._retraction: Trapezoid | None = None  # that is made on the way, so many samples of it
        self._retracted = 0
        self._events: list[Event] = []
        self._at_rest: list[bytes] = []  # lines at the end of motion: the command comes to rest
        self._held: list[Samples] = []

    # ------------------------------------------------------------------ motion

    def run(self, plan: Plan) -> Iterator[Samples]:
        """Samples of the runs of a plan."""
        yield from self._set_out(plan)
        phases, self._clock = self._phases(plan)
        stops = plan.speed[-1] == 0.0
        stop = self._section + (
            math.ceil(self._clock / TS - ON_TIME) if stops else math.floor(self._clock / TS)
        )
        marks, end = list(plan.marks), len(plan.line)
        self._labelled |= any(self._rests.labels(mark.text) for mark in marks)
        self._acceleration = float(plan.acceleration[-1])
        if stops:
            self._at_rest = [mark.text for mark in marks if mark.index == end]
            marks = [mark for mark in marks if mark.index < end]
        for first in range(self._index, stop + 1, SAMPLES_PER_CHUNK):
            n = min(SAMPLES_PER_CHUNK, stop + 1 - first)
            arrives = stops and first + n > stop
            s = phases.path(first - self._section, n, float(plan.s[-1]))
            if arrives:
                s[-1] = plan.s[-1]
            xyze, move = _follow(plan, s)
            if self._pinned is not None:
                xyze[0, E], self._pinned = self._pinned, None
            marks = self._pin(plan, marks, s, xyze)
            if arrives:
                xyze[-1] = plan.points[-1]
            if self._retraction is not None:
                xyze[:, E] += self._held_back(n)
            self._emit(xyze, plan.line[move])
            yield from self.flush()
        for mark in marks:  # between the last sample of this plan and the first of the next
            self._events.append(Mark(self._index, mark.text))
            self._pinned = float(plan.points[mark.index, E])
        self._moving = not stops

    def _set_out(self, plan: Plan) -> Iterator[Samples]:
        """From standstill, if the machine stands."""
        self._line = int(plan.line[0])
        self._pass_at_rest()
        if self._last is None:
            yield from self._stand(plan.points[0], 1)  # from where the motion starts
        if self._rested:
            self._labelled = False
            aside = self._aside
            yield from self._rest(plan.points[0], self._rests.aside if aside else self._rests.after)
            self._rested = self._aside = False
        if not self._moving:
            self._section, self._clock, self._moving = self._index - 1, 0.0, True

    def _phases(self, plan: Plan) -> tuple[Phases, float]:
        """Phases of all runs on the section's clock, points of rest on whole samples."""
        t, j = self._profiler.profiles(plan, self._limits.jerk)
        a, v, steps = integrated(t, j, plan.speed[:-1])
        at_rest = np.flatnonzero(plan.speed[1:] == 0.0)
        end = self._clock + np.cumsum(t.sum(axis=1))
        late = np.zeros(len(end))  # standstill after a run, to the next whole sample
        for run in at_rest:  # few: corners without speed
            now = (end[run] + late[:run].sum()) / TS
            late[run] = max(math.ceil(now - ON_TIME) - now, 0.0) * TS
        start = np.concatenate([[self._clock], end + np.cumsum(late)])
        s = plan.s[plan.ends[:-1], None] + before_each(np.cumsum(steps, axis=1))
        time = start[:-1, None] + before_each(np.cumsum(t, axis=1))
        keep = t.ravel() > 0.0
        table = np.stack([column.ravel()[keep] for column in (time, t, s, v, a, j)])
        return Phases(table), float(start[-1])

    def _pin(self, plan: Plan, marks: list[Mark], s: Array, xyze: Array) -> list[Mark]:
        """Marks go to the first sample at or after their vertex, with the vertex's filament.

        So what is extruded between two marks is exact, not rounded to a sample. Returns the
        marks that lie beyond these samples.
        """
        vertices = np.array([mark.index for mark in marks], dtype=np.int64)
        rows = np.searchsorted(s, plan.s[vertices])
        here = int(np.searchsorted(rows, len(s)))
        xyze[rows[:here], E] = plan.points[vertices[:here], E]
        self._events += [
            Mark(self._index + row, mark.text)
            for row, mark in zip(rows[:here].tolist(), marks, strict=False)
        ]
        return marks[here:]

    # ------------------------------------------------------------------ rest

    def mark(self, text: bytes) -> None:
        """A carried line at the present sample, or with those that wait for the command's rest."""
        self._labelled |= self._rests.labels(text)
        if self._at_rest:
            self._at_rest.append(text)
        else:
            self._events.append(Mark(self._index, text))

    def pause(
        self, action: Standing | Passthrough, motion: Plan | None = None
    ) -> Iterator[Samples]:
        """What the machine does while x and y stand still. motion: that it may pass into."""
        if self._last is None and isinstance(action, Standing):
            yield from self._stand(np.array(action.start), 1)
        if isinstance(action, Standing):
            yield from self._standing(action, motion)
            return
        self._labelled |= self._rests.labels(action.text)
        released = action.handling is Handling.RELEASE
        n = math.ceil(action.seconds / TS - ON_TIME)
        yield from self._come_to_rest(released or n >= self._rests.long)
        self._line = action.line
        if self._last is None:  # there is nothing to sample where the place is unknown
            self._events.append(Pause(self._index, 0, action))
        else:
            self._events.append(Pause(self._index, n, action, action.seconds))
            yield from self._stand(self._last, n)
        if released:
            yield from self.flush(ends_stretch=True)
            self._last = None

    def _standing(self, move: Standing, motion: Plan | None) -> Iterator[Samples]:
        """A retraction or a lift, which may pass from and into motion without rest."""
        if motion is not None and self._on_the_way(move, motion):
            return
        entry = leaving = 0.0
        if not self._rested:
            entry = self._passing(self._acceleration)
        if motion is not None and not self._labelled and not (self._rested and self._aside):
            leaving = self._passing(float(motion.acceleration[0]))
        profile = StandingProfile.from_move(move, self._limits, entry, leaving)
        if long := profile.samples >= self._rests.long:
            profile = StandingProfile.from_move(move, self._limits)
        entry, leaving = profile.trapezoid.v_s, profile.trapezoid.v_e
        yield from self._come_to_rest(long, passing=entry > 0.0)
        self._line = move.line
        self._events.append(
            Pause(self._index, profile.samples, move, profile.seconds, entry, leaving)
        )
        yield from self._moved(move, profile)
        self._rested = leaving == 0.0

    def _on_the_way(self, move: Standing, motion: Plan) -> bool:
        """Whether it is a retraction that is made on the travel, which has time for it."""
        length = move.start[E] - move.end[E]
        if not self._rests.moving or self._rested or length <= 0.0 or move.end[Z] != move.start[Z]:
            return False
        speed = min(move.speed, self._limits.extruder_velocity)
        way = Trapezoid(length, speed, self._rests.moving)
        still = np.flatnonzero(np.diff(motion.points[:, E]) != 0.0)
        travel = float(motion.s[still[0]] if len(still) else motion.s[-1])
        if travel < way.seconds * float(motion.cruise.max()):
            return False
        self._retraction, self._retracted = way, 0
        return True

    def _held_back(self, n: int) -> Array:
        """Filament (n,), mm, that a retraction on the way has not taken yet at the next samples."""
        way = self._retraction
        assert way is not None
        t = TS * np.arange(self._retracted + 1.0, self._retracted + n + 1.0)
        self._retracted += n
        if t[-1] >= way.seconds:
            self._retraction = None
        return np.where(t < way.seconds, way.length - way.distance(t), 0.0)

    def _passing(self, acceleration: float) -> float:
        """Speed of z, mm/s, at which a lift passes from or into motion with that acceleration."""
        return min(SPARED * self._rests.corner, SURELY_HAD * math.sqrt(acceleration))

    def halt(self) -> Iterator[Samples]:
        """The command comes to rest on the path."""
        yield from self._come_to_rest(aside=True)

    def _come_to_rest(self, aside: bool, passing: bool = False) -> Iterator[Samples]:
        if not self._rested and self._last is not None and not passing:
            yield from self._rest(self._last, self._rests.aside if aside else self._rests.before)
        self._pass_at_rest()
        self._aside = aside or (self._rested and self._aside)
        self._rested, self._moving = True, False

    def _pass_at_rest(self) -> None:
        self._events += [Mark(self._index, text) for text in self._at_rest]
        self._at_rest = []

    def _rest(self, where: Array, samples: int) -> Iterator[Samples]:
        if samples:
            self._events.append(Rest(self._index, samples))
            yield from self._stand(where, samples)

    def _stand(self, where: Array, samples: int) -> Iterator[Samples]:
        """Standstill; a long one in several chunks."""
        for first in range(0, samples, SAMPLES_PER_CHUNK):
            n = min(samples - first, SAMPLES_PER_CHUNK)
            self._emit(np.tile(where, (n, 1)), np.full(n, self._line))
            if first + n < samples:
                yield from self.flush()

    def _moved(self, move: Standing, profile: StandingProfile) -> Iterator[Samples]:
        """z and e on their way, x and y still; a slow one in several chunks."""
        for first in range(0, profile.samples, SAMPLES_PER_CHUNK):
            n = min(profile.samples - first, SAMPLES_PER_CHUNK)
            xyze = np.tile(np.array(move.end), (n, 1))
            start, end = np.array(move.start[Z:]), np.array(move.end[Z:])
            xyze[:, Z:] = start + profile.share(np.arange(first + 1, first + n + 1)) * (end - start)
            self._emit(xyze, np.full(n, self._line))
            if first + n < profile.samples:
                yield from self.flush()

    # ------------------------------------------------------------------ chunks

    def finish(self) -> Iterator[Samples]:
        """What is left."""
        self._pass_at_rest()
        yield from self.flush()

    def _emit(self, xyze: Array, line: Integers) -> None:
        if len(xyze):
            self._held.append(Samples(self._index, frozen(xyze), line))
            self._index += len(xyze)
            self._last = xyze[-1]

    @property
    def held(self) -> int:
        """Samples that are in no chunk yet."""
        return sum(map(len, self._held))

    def flush(self, ends_stretch: bool = False) -> Iterator[Samples]:
        """What is held, as one chunk with its events."""
        if not self._held and not self._events:
            return
        first = self._index - self.held
        empty = Samples(first, frozen(np.zeros((0, 4))), np.zeros(0, dtype=np.int64))
        chunks = self._held or [empty]
        xyze = np.concatenate([c.xyze for c in chunks])
        line = np.concatenate([c.line for c in chunks])
        yield Samples(first, frozen(xyze), line, tuple(self._events), ends_stretch=ends_stretch)
        self._held, self._events = [], []


def _follow(plan: Plan, s: Array) -> tuple[Array, Integers]:
    """x, y, z, e at path lengths ``s`` (n,), and the move that each lies on."""
    n, moves = len(s), len(plan.line)
    if (compiled := kernel("follow")) is None:
        return _followed(plan, s)
    xyze, move = np.empty((n, 4)), np.empty(n, dtype=np.int64)
    compiled(plan.s, np.ascontiguousarray(plan.points), moves, s, n, xyze, move)
    return xyze, move


def _followed(plan: Plan, s: Array) -> tuple[Array, Integers]:
    move = np.clip(np.searchsorted(plan.s, s, side="right") - 1, 0, len(plan.line) - 1)
    start = plan.points[move]
    share = (s - plan.s[move]) / (plan.s[move + 1] - plan.s[move])
    return start + share[:, None] * (plan.points[move + 1] - start), move
