"""Samples → the steps of the motors, on the ticks of a stepping clock.

Rules:
 1. Between samples the command is a monotone cubic. A motor steps where it
    crosses the middle between two whole steps, on the next tick. Sample i is where the command
    is at the end of millisecond i.
 2. A motor steps once a tick at most, and ``direction_setup`` after its last step when it
    turns. A step that comes too soon is late, never lost; a command faster than the clock is
    an error.
 3. Positions are whole steps from the origin of the coordinates: rounding never adds up.
 4. At a line that needs rest, all steps before it have been made, and none after it.

Symbols of the cubic:

=========  ============================================================
``u``      position in steps plus ½, so that ⌊u⌋ is the rounded position
``m``      tangent of the cubic at a sample, in steps a sample
``s``      share of the interval between two samples, 0 … 1
=========  ============================================================

Its tangents are those of Catmull and Rom, limited after Fritsch and Carlson (SIAM J. Numer.
Anal. 17, 1980): between two samples the command never turns back, so the rounded positions
of the samples alone give the number of steps between them.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import takewhile

import numpy as np

from hframe_post.arrays import TS, Array, Integers, Z
from hframe_post.compensation.guard import LEEWAY
from hframe_post.errors import LimitError
from hframe_post.model.kinematics import Kinematics
from hframe_post.printer.settings import Steps
from hframe_post.stream.chunks import stretches
from hframe_post.stream.marks import Marks
from hframe_post.stream.types import Dwell, Handling, Passthrough, Samples
from hframe_post.writers.tables import KEY_BITS, MOTORS, End, Item, Note, Start, Stepped

GRAIN_DECIMALS = 9  # decimals of a mm; finer differences are noise, on which no motor must tremble
SAMPLES_AT_ONCE = 1 << 14
MAX_LATE_S = 1e-3  # s that a step may be late beyond direction_setup

HANDLINGS = {Handling.CARRY: "carried", Handling.REST: "rest", Handling.RELEASE: "yielded"}


@dataclass(slots=True)
class StepCounts:
    """Counts by motor (4,) so far: all steps, and forward minus backward steps.

    starts: number of ``Start`` items; passed: mm of filament in lines passed on; ticks: of the
    whole print, at its end.
    """

    steps: Integers
    net: Integers
    starts: int = 0
    passed: float = 0.0
    ticks: int = 0


class StepGenerator:
    """Stage that turns a strategy's command into steps, and ``counts`` them.

    Keeps the samples whose intervals are not finished, and steps that are not yet in order.
    """

    def __init__(self, strategy: str, kinematics: Kinematics, table: Steps) -> None:
        self._strategy, self._kinematics = strategy, kinematics
        self.counts = StepCounts(*np.zeros((2, len(MOTORS)), dtype=np.int64))
        self._lengths = np.array([table.belt, table.belt, table.z, table.e])
        self._per_sample, self._clock = table.clock_hz * TS, table.clock_hz
        self._motors = [_Motor(letter, table) for letter in MOTORS]
        self._known = False  # whether the motors' positions are
        self._u = np.zeros((0, len(MOTORS)))  # the sample before the first interval, and on
        self._line = np.zeros(0, dtype=np.int64)
        self._index = 0  # of the sample _u[1]
        self._end = 0  # index after the last sample taken
        self._floor = 0  # tick of the last line at rest
        self._keys = np.zeros(0, dtype=np.int64)
        self._notes: list[Note] = []

    def step(self, chunks: Iterable[Samples]) -> Iterator[Item]:
        """Yield the steps, with a ``Start`` after each release. Raises LimitError."""
        for stretch in stretches(chunks):
            for chunk in stretch:
                yield from self._chunk(chunk)
            self._known = False
        yield from self._rest(self._end)
        yield End(self._floor)
        self.counts.ticks = self._floor

    def _chunk(self, chunk: Samples) -> Iterator[Item]:
        x, y = chunk.commands[self._strategy].T
        mm = np.column_stack([*self._kinematics.belts(x, y), chunk.xyze[:, Z:]])
        u = np.round(mm, GRAIN_DECIMALS) / self._lengths + 0.5
        done = 0
        for event in chunk.events:
            if isinstance(event, Marks):
                for mark in event:
                    tick = max(self._tick(mark.index), self._floor)
                    self._notes.append(Note(tick, HANDLINGS[Handling.CARRY], mark.text))
            elif isinstance(event, Dwell) and isinstance(event.action, Passthrough):
                at = event.index - chunk.first
                yield from self._take(u[done:at], chunk, done)
                done = at
                yield from self._rest(event.index)
                name = HANDLINGS[event.action.handling]
                if event.action.handling is Handling.RELEASE:
                    self.counts.passed += event.action.filament
                    name = name if event.action.text else "end"
                self._notes.append(Note(self._floor, name, event.action.text))
        yield from self._take(u[done:], chunk, done)

    def _tick(self, index: int) -> int:
        return math.ceil(index * self._per_sample)  # where the millisecond of a sample begins

    def _take(self, u: Array, chunk: Samples, row: int) -> Iterator[Item]:
        """Take samples u (n, 4) from row ``row`` of the chunk on."""
        if not len(u):
            return
        line = chunk.line[row : row + len(u)]
        self._end = chunk.first + row + len(u)
        if not self._known:
            self._known, self._index = True, chunk.first + row
            self._u, self._line = np.repeat(u[:1], 2, axis=0), np.repeat(line[:1], 2)
            tick = max(self._tick(self._index), self._floor)
            yield from self._emit(tick + 1)  # what was noted on the way here
            self.counts.starts += 1
            yield Start(tick, tuple(np.floor(u[0]).astype(int).tolist()))
            u, line = u[1:], line[1:]
        for k in range(0, len(u), SAMPLES_AT_ONCE):
            self._advance(u[k : k + SAMPLES_AT_ONCE], line[k : k + SAMPLES_AT_ONCE])
            yield from self._emit(self._tick(self._index + 1))

    def _rest(self, index: int) -> Iterator[Item]:
        """Yield everything up to sample ``index``, before which the machine is at rest."""
        if self._known:
            self._advance(self._u[-1:], self._line[-1:])
            self._u, self._line = self._u[1:], self._line[1:]
        last = self._keys.max(initial=0) >> KEY_BITS
        self._floor = max(self._floor, self._tick(index), int(last))
        yield from self._emit(None)

    def _advance(self, u: Array, line: Integers) -> None:
        """Add samples u (n, 4), and the steps of intervals that have a sample on either side."""
        self._u, self._line = np.concatenate([self._u, u]), np.concatenate([self._line, line])
        n = len(self._u) - 3
        if n < 1:
            return
        self._check_speed()
        keys = [self._keys]
        for k, motor in enumerate(self._motors):
            interval, share, direction = crossings(np.ascontiguousarray(self._u[:, k]))
            if not len(interval):
                continue
            time = (self._index + 1 + interval + share) * self._per_sample
            due = np.maximum(np.ceil(time).astype(np.int64), self._floor + 1)
            ticks = motor.place(due, direction, self._line[2:][interval])
            keys.append((ticks << KEY_BITS) + (2 * k + (direction > 0)))
            self.counts.steps[k] += len(ticks)
            self.counts.net[k] += int(direction.sum())
        self._keys = np.sort(np.concatenate(keys), kind="stable")  # merges what is sorted
        self._u, self._line, self._index = self._u[n:], self._line[n:], self._index + n

    def _check_speed(self) -> None:
        """Raise LimitError if the stepping clock is too slow for the command."""
        rate = np.abs(np.diff(self._u[1:-1], axis=0))
        over = ~(rate <= self._per_sample * LEEWAY)  # NaN counts as over, too
        if over.any():
            k = int(np.argmax(over.any(axis=1)))
            motor = int(np.argmax(over[k]))
            mm = self._lengths[motor]
            raise LimitError(
                f"speed of motor {MOTORS[motor]} (mm/s)", float(rate[k, motor] * mm / TS),
                float(self._clock * mm), int(self._line[k + 2]),
                "raise steps.clock_hz in the profile if the controller allows it, take longer "
                "steps, or lower the print's speed",
            )  # fmt: skip

    def _emit(self, before: int | None) -> Iterator[Item]:
        """Yield steps and notes of ticks below ``before``; None: all."""
        if before is None:
            keys, self._keys = self._keys, self._keys[:0]
            notes, self._notes = tuple(self._notes), []
        else:
            at = int(np.searchsorted(self._keys, before << KEY_BITS))
            keys, self._keys = self._keys[:at], self._keys[at:]
            n = sum(1 for _ in takewhile(lambda note: note.tick < before, self._notes))
            notes, self._notes = tuple(self._notes[:n]), self._notes[n:]
        if len(keys) or notes:
            yield Stepped(keys, notes)


class _Motor:
    """The last step of one motor: its tick and direction."""

    def __init__(self, letter: str, table: Steps) -> None:
        self._letter, self._clock = letter, table.clock_hz
        self._gap = max(1, math.ceil(table.direction_setup * table.clock_hz - 1e-9))
        self._latest = self._gap + math.ceil(MAX_LATE_S * table.clock_hz)
        self._last, self._heading = -self._gap, 0

    def place(self, due: Integers, direction: Integers, line: Integers) -> Integers:
        """Return the ticks (k,) of the next steps, k ≥ 1. Raises LimitError if one is late."""
        ticks = spaced(due, direction, self._gap, self._last, self._heading)
        late = ticks - due
        if late.max() > self._latest:
            k = int(np.argmax(late > self._latest))
            raise LimitError(
                f"delay of a step of motor {self._letter} (s)", int(late[k]) / self._clock,
                self._latest / self._clock, int(line[k]),
                "lower steps.direction_setup in the profile if the drivers allow it, or raise "
                "effort in [compensation]",
            )  # fmt: skip
        self._last, self._heading = int(ticks[-1]), int(direction[-1])
        return ticks


def crossings(u: Array, close: float = 1e-3) -> tuple[Integers, Array, Integers]:
    """Return the steps between the inner n − 2 of n samples u (n,), in order: (k,) each.

    Returns the interval of each (0: after the second sample), its share s there, and its
    direction, 1 or −1. The outer samples only shape the tangents.
    close: steps from a half step that count as on it.
    """
    at = np.floor(u[1:-1]).astype(np.int64)
    change = at[1:] - at[:-1]
    which = np.flatnonzero(change)
    if not len(which):
        return which, np.zeros(0), which
    change, at, start = change[which], at[which], u[which + 1]
    count, heading = np.abs(change), np.sign(change)
    interval = np.repeat(which, count)
    nth = np.arange(len(interval)) - np.repeat(np.cumsum(count) - count, count)
    # upwards the levels are those above ⌊u⌋, downwards ⌊u⌋ itself and those below
    first = np.abs(at + (heading > 0) - start)
    slope = u[1:] - u[:-1]
    before, d, after = (slope[which + k] * heading for k in range(3))
    m0, m1 = _tangents(before, d), _tangents(d, after)
    c2, c3 = 3.0 * d - 2.0 * m0 - m1, m0 + m1 - 2.0 * d
    c1, c2, c3, level = (np.repeat(column, count) for column in (m0, c2, c3, first))
    return interval, _solved(c1, c2, c3, level + nth, close), np.repeat(heading, count)


def _tangents(before: Array, after: Array) -> Array:
    """Return m (n,) at samples between slopes before and after them, (n,) steps a sample each."""
    least = 3.0 * np.minimum(np.abs(before), np.abs(after))  # monotone below
    m = np.clip((before + after) / 2.0, -least, least)
    return np.asarray(m * (before * after > 0.0))


def _solved(c1: Array, c2: Array, c3: Array, level: Array, close: float) -> Array:
    """Return s (k,) in 0 … 1 at which the rising cubics c1·s + c2·s² + c3·s³ reach ``level``.

    Uses Newton's method from the parabola with the same start and end. Where that does not
    converge (mostly next to a stop), it halves the interval.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        s = 2.0 * level / (c1 + np.sqrt(c1 * c1 + 4.0 * (c2 + c3) * level))
        for _ in range(3):
            h = c3 * s
            t = h + c2
            h += t
            h *= s
            t *= s
            t += c1
            h += t  # the slope
            t *= s
            t -= level  # what is missing
            t /= h
            s -= t
    off = s * (c1 + s * (c2 + s * c3))
    off -= level
    np.abs(off, out=off)
    arrived = (off <= close) & (s >= 0.0) & (s <= 1.0)
    if not arrived.all():
        few = np.flatnonzero(~arrived)
        s[few] = _halved(c1[few], c2[few], c3[few], level[few])
    return s


def _halved(c1: Array, c2: Array, c3: Array, level: Array) -> Array:
    s = np.full(len(level), 0.5)
    for k in range(2, 40):
        s += np.where(s * (c1 + s * (c2 + s * c3)) < level, 0.5**k, -(0.5**k))
    return s


def spaced(due: Integers, direction: Integers, gap: int, last: int, heading: int) -> Integers:
    """Return the ticks (k,) of one motor's steps in order, none before it is ``due`` (k,).

    At most one step a tick, and ``gap`` ticks from a step to the next in the other direction.
    last, heading: tick and direction of the step before these; 0: there was none.
    """
    turns = np.diff(direction, prepend=heading) != 0
    turns[:1] &= heading != 0
    least = np.where(turns, gap, 1)
    if (np.diff(due, prepend=last) >= least).all():
        return due
    least = np.cumsum(least)
    before = np.concatenate([[last], due - least])
    return np.asarray(np.maximum.accumulate(before)[1:] + least)
