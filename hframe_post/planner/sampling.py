"""Runs → samples: Ruckig's jerk-limited profile of every run, on one clock.

Each run is planned along the path length, from speed to speed at zero acceleration, and x,
y, z and e follow the path: extrusion stays proportional to it. Points of rest fall on whole
samples. Before and after anything that the machine does at rest there is standstill in
which the compensated command may settle and lead.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator

import numpy as np

from hframe_post.arrays import TS, Array, E, Integers, Z
from hframe_post.planner.jerk_profile import Phases, Profiler, before_each, integrated
from hframe_post.printer.settings import Limits
from hframe_post.stream.types import (
    Event,
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
ON_TIME = 1e-9  # samples; a rest this close after a sample falls on it


def sample(planned: Iterable[Planned], limits: Limits, rests: Rests) -> Iterator[Samples]:
    """Samples of the whole stream. A chunk ends where the machine is released."""
    sampler = _Sampler(limits, rests)
    for item in planned:
        if isinstance(item, Plan):
            yield from sampler.run(item)
        elif isinstance(item, Passthrough) and item.handling is Handling.CARRY:
            sampler.mark(item.text)
        else:
            yield from sampler.pause(item)
    yield from sampler.flush()


class _Sampler:
    """The clock: next sample, where it stands, and the time since the last rest."""

    def __init__(self, limits: Limits, rests: Rests) -> None:
        self._limits, self._rests = limits, rests
        self._profiler = Profiler()
        self._index = 0  # of the next sample
        self._moving = False
        self._rested = True  # the machine stands and nothing has been offered to lead
        self._section, self._clock = 0, 0.0  # sample of the last rest, s since then
        self._last: Array | None = None  # x, y, z, e at the last sample
        self._pinned: float | None = None  # filament at a mark on the next sample
        self._line = 0
        self._events: list[Event] = []
        self._held: list[Samples] = []

    # ------------------------------------------------------------------ motion

    def run(self, plan: Plan) -> Iterator[Samples]:
        """Samples of the runs of a plan."""
        self._line = int(plan.line[0])
        if self._rested:
            self._events.append(Rest(self._index, self._rests.lead, settling=False))
            self._stand(plan.points[0], self._rests.lead)
            self._rested = False
        if not self._moving:
            self._section, self._clock, self._moving = self._index - 1, 0.0, True
        phases, self._clock = self._phases(plan)
        stops = plan.speed[-1] == 0.0
        stop = self._section + (
            math.ceil(self._clock / TS - ON_TIME) if stops else math.floor(self._clock / TS)
        )
        marks = list(plan.marks)
        for first in range(self._index, stop + 1, SAMPLES_PER_CHUNK):
            index = np.arange(first, min(first + SAMPLES_PER_CHUNK, stop + 1))
            t = TS * (index - self._section).astype(float)
            s = np.clip(phases.path(t), 0.0, plan.s[-1])
            if stops and index[-1] == stop:
                s[-1] = plan.s[-1]
            xyze, move = _follow(plan, s)
            if self._pinned is not None:
                xyze[0, E], self._pinned = self._pinned, None
            marks = self._pin(plan, marks, s, xyze)
            if stops and index[-1] == stop:
                xyze[-1] = plan.points[-1]
            self._emit(xyze, plan.line[move])
            yield from self.flush()
        for mark in marks:  # between the last sample of this plan and the first of the next
            self._events.append(Mark(self._index, mark.text))
            self._pinned = float(plan.points[mark.index, E])
        self._moving = not stops

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
        table = (column.ravel()[keep] for column in (time, t, s, v, a, j))
        return Phases(*table), float(start[-1])

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
        """A carried line at the present sample."""
        self._events.append(Mark(self._index, text))

    def pause(self, action: Standing | Passthrough) -> Iterator[Samples]:
        """What the machine does while x and y stand still."""
        if self._last is None and isinstance(action, Standing):
            self._stand(np.array(action.start), 1)
        if not self._rested and self._last is not None:
            self._events.append(Rest(self._index, self._rests.settle, settling=True))
            self._stand(self._last, self._rests.settle)
        self._rested, self._moving = True, False
        if isinstance(action, Standing):
            self._line = action.line
            exact, z_e = standing(action, self._limits)
            self._events.append(Pause(self._index, len(z_e), action, exact))
            xyze = np.tile(np.array(action.end), (len(z_e), 1))
            xyze[:, Z:] = z_e
            self._emit(xyze, np.full(len(z_e), self._line))
            return
        self._line = action.line
        if self._last is None:  # there is nothing to sample where the place is unknown
            self._events.append(Pause(self._index, 0, action))
        else:
            n = math.ceil(action.seconds / TS - ON_TIME)
            self._events.append(Pause(self._index, n, action, action.seconds))
            self._stand(self._last, n)
        if action.handling is Handling.RELEASE:
            yield from self.flush(ends_stretch=True)
            self._last = None

    def _stand(self, where: Array, samples: int) -> None:
        self._emit(np.tile(where, (samples, 1)), np.full(samples, self._line))

    # ------------------------------------------------------------------ chunks

    def _emit(self, xyze: Array, line: Integers) -> None:
        if len(xyze):
            self._held.append(Samples(self._index, frozen(xyze), line))
            self._index += len(xyze)
            self._last = xyze[-1]

    def flush(self, ends_stretch: bool = False) -> Iterator[Samples]:
        """What is held, as one chunk with its events."""
        if not self._held and not self._events:
            return
        first = self._index - sum(map(len, self._held))
        empty = Samples(first, frozen(np.zeros((0, 4))), np.zeros(0, dtype=np.int64))
        chunks = self._held or [empty]
        xyze = np.concatenate([c.xyze for c in chunks])
        line = np.concatenate([c.line for c in chunks])
        yield Samples(first, frozen(xyze), line, tuple(self._events), ends_stretch=ends_stretch)
        self._held, self._events = [], []


def standing(move: Standing, limits: Limits) -> tuple[float, Array]:
    """Exact duration and samples (n, 2) of z and e, as the firmware does one such line.

    The firmware knows no jerk: the profile is a trapezoid.
    """
    dz, de = abs(move.end[Z] - move.start[Z]), abs(move.end[E] - move.start[E])
    length = dz or de
    cruise = min(move.speed, limits.z_velocity) if dz else move.speed
    acceleration = limits.z_acceleration if dz else math.inf
    if de:  # without x and y any extrusion counts as retraction
        cruise = min(cruise, limits.extruder_velocity * length / de)
        acceleration = min(acceleration, limits.extruder_acceleration * length / de)
    peak = min(cruise, math.sqrt(length * acceleration))
    ramp = peak / acceleration
    exact = length / peak + ramp
    n = math.ceil(exact / TS - ON_TIME)
    t = np.minimum(np.arange(1, n + 1) * TS, exact)
    up, down = np.minimum(t, ramp), np.maximum(t - (exact - ramp), 0.0)
    s = acceleration * (up * up - down * down) / 2.0 + peak * (t - up)
    share = (s / length)[:, None]
    share[-1] = 1.0
    start, end = np.array(move.start[Z:]), np.array(move.end[Z:])
    return exact, start + share * (end - start)


def _follow(plan: Plan, s: Array) -> tuple[Array, Integers]:
    """x, y, z, e at path lengths ``s`` (n,), and the move that each lies on."""
    move = np.clip(np.searchsorted(plan.s, s, side="right") - 1, 0, len(plan.line) - 1)
    start = plan.points[move]
    share = (s - plan.s[move]) / (plan.s[move + 1] - plan.s[move])
    return start + share[:, None] * (plan.points[move + 1] - start), move
