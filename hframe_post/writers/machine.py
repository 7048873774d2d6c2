"""First pass: samples → typed commands, by where the machine is and whose limits hold."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np

from hframe_post.arrays import TS, Array, E, Integers, X, Y, Z
from hframe_post.firmware.code import Code
from hframe_post.firmware.motion import MotionRules, Way
from hframe_post.gcode.commands import Line, name_and_arguments
from hframe_post.stream.marks import Marks, recent
from hframe_post.stream.types import (
    Dwell,
    Handling,
    MoveAtRest,
    Passthrough,
    Samples,
    SlowStraight,
)
from hframe_post.writers.carried import NOTHING_BETWEEN, Between, text_of
from hframe_post.writers.decimation import (
    SAMPLES_AT_ONCE,
    Batch,
    Place,
    SampleBuffer,
    Segments,
    Units,
    check_filament,
    rows_before,
    segments,
)
from hframe_post.writers.filament_ledger import Ledger
from hframe_post.writers.print_time import Output


class Text(NamedTuple):
    """Lines without a speed."""

    output: Output


class Motion(NamedTuple):
    """Segments (k,) in which something moves.

    at (k + 1, 4): places, in output units; T (k,): seconds that each is to last; dwell (k,):
    samples of dwell before each; between: other lines.
    stops: whether the machine rests after the last; after: greatest speed, mm/s, at its end.
    """

    at: Integers
    T: Array
    dwell: Integers
    between: Between
    stops: bool
    after: float


class PlacedMove(NamedTuple):
    """A retraction or a lift, from place to place; speed, acceleration: see ``MoveAtRest``."""

    dwell: Dwell
    speed: float
    acceleration: float
    lifts: bool
    start: Place
    end: Place


class MotionEnd(NamedTuple):
    """The machine is at rest, and dwells for this many samples more."""

    samples: int = 0


class LimitChange(NamedTuple):
    """Lines that change feed rate and limits, after which the stream's own count no more."""

    text: bytes


OutputCommand = Text | Motion | PlacedMove | MotionEnd | LimitChange


class Machine:
    """The machine's place, and whether the stream's limits and modes hold.

    at: where another stream ended; None: only firmware knows. offset: of G92, while the machine is
    released.
    """

    def __init__(
        self,
        strategy: str,
        rules: MotionRules,
        code: Code,
        units: Units,
        at: Place | None,
        offset: tuple[float, float, float],
    ) -> None:
        self._strategy, self._units = strategy, units
        self._rules, self._code = rules, code
        self._modes_after = recent(
            lambda line: code.modes_after(name_and_arguments(Line(0, line))[0], line)
        )
        self._at, self._offset = at, offset
        self._inside = at is not None  # the stream's limits and modes hold
        self._buffer = SampleBuffer()
        self._skip = 0  # samples of a dwell in the next chunks
        self._end = 0  # of the last chunk
        self._still = 0  # samples of dwell since the last segment
        self.ledger = Ledger(at[E] if at is not None else 0)

    def commands(self, chunks: Iterable[Samples]) -> Iterator[OutputCommand]:
        """Yield the commands in order."""
        if self._inside:
            yield self._count()
        for chunk in chunks:
            yield from self._chunk(chunk)
        yield from self._stop()

    def _chunk(self, chunk: Samples) -> Iterator[OutputCommand]:
        self._skip = max(self._skip - (chunk.first - self._end), 0)  # those left out
        self._end = chunk.end
        done = min(self._skip, len(chunk))
        self._skip -= done
        for event in chunk.events:
            at = event.index - chunk.first
            if isinstance(event, Marks):
                yield from self._take(chunk, done, at)
                done = max(at, done)
                self._buffer.add_marks(event)
                if not self._buffer:
                    yield from self._marks(chunk.first + done)
            elif isinstance(event, Dwell):
                yield from self._take(chunk, done, at)
                yield from self._stop(self._speed_into(event))
                yield from self._dwell(event)
                done = min(at + event.samples, len(chunk))
                self._skip = at + event.samples - done
            elif isinstance(event, SlowStraight):
                yield from self._take(chunk, done, at)
                done = max(at, done)
                yield from self._slow_straight(event)
        yield from self._take(chunk, done, len(chunk))

    def _slow_straight(self, slow: SlowStraight) -> Iterator[OutputCommand]:
        """Yield a straight whose samples are left out, as one segment."""
        if batch := self._buffer.batch(last=False):
            yield from self._motion(batch)
        assert self._at is not None
        start, end = self._at, self._units.place(slow.end)
        self._buffer.resume(slow.end)
        self._still += slow.samples
        if end == start:
            return
        yield from self._enter()
        self.ledger.moved([slow.index + slow.samples - 1], end[E] - start[E])
        self._at = end
        at, T = np.array([start, end]), np.array([self._still * TS])
        self._still = 0
        yield Motion(at, T, np.zeros(1, np.int64), NOTHING_BETWEEN, False, math.inf)

    def _take(self, chunk: Samples, start: int, stop: int) -> Iterator[OutputCommand]:
        if start >= stop:
            return
        xy, xyze = chunk.commands[self._strategy], chunk.xyze
        if self._at is None:  # the first sample may have extruded on its way here
            (x, y), z = xy[start].tolist(), float(xyze[start, Z])
            self._at = self._units.place((x, y, z, self.ledger.filament))
        here = self._units.mm(self._at)
        while start < stop:
            if len(self._buffer) == SAMPLES_AT_ONCE and (batch := self._buffer.batch(last=False)):
                yield from self._motion(batch)
            rows = slice(start, stop)
            ahead = chunk.advance[rows, 0] if chunk.advance is not None and chunk.in_e else None
            start += self._buffer.add(xy[rows], xyze[rows], ahead, chunk.first + start, here)

    def _stop(self, speed: float = 0.0) -> Iterator[OutputCommand]:
        """Yield what is buffered, up to rest or to a lift that begins at a speed, mm/s."""
        if batch := self._buffer.batch(last=True):
            yield from self._motion(batch, speed)
        if not speed:
            yield MotionEnd()
        yield from self._marks()

    def _marks(self, index: int | None = None) -> Iterator[OutputCommand]:
        if marks := self._buffer.marks_up_to(index):
            yield self._passed_on(marks)

    def _speed_into(self, dwell: Dwell) -> float:
        """Return the speed, mm/s, at which motion passes into a dwell; 0: it stops."""
        if not isinstance(move := dwell.action, MoveAtRest):
            return 0.0
        way, planned = Way(move.start, move.end, move.acceleration), (dwell.entry, dwell.leaving)
        return self._rules.corners(way, move.speed, planned)[0]

    def _motion(self, batch: Batch, speed: float = 0.0) -> Iterator[OutputCommand]:
        """Yield the commands for a batch, whose motion may end at a speed, mm/s."""
        assert self._at is not None
        still = self._still
        made = segments(batch, self._at, still, self._rules, self._units)
        self._still = made.still
        if len(made.T):
            yield from self._enter()
            between = self._between(batch, made, still) if batch.marks else NOTHING_BETWEEN
            stops = batch.last and not (speed and not self._still)
            x, y, z, e = made.at[-1].tolist()
            self.ledger.moved(batch.first + made.ends, e - self._at[E])
            self._at = x, y, z, e
            yield Motion(made.at, made.T, made.dwell, between, stops, speed or math.inf)
        else:
            if batch.marks:
                yield self._passed_on(batch.marks)
        if batch.last and self._still:
            yield MotionEnd(self._still if self._inside else 0)
            self._still = 0

    def _between(self, batch: Batch, made: Segments, still: int) -> Between:
        """Return the lines of the file in a batch, among its segments."""
        check_filament(batch, made.ends, made.at[:, E] / self._units.per_mm[E], still)
        return Between.from_marks(batch.marks, rows_before(batch, made.ends), self._modes_after)

    def _passed_on(self, marks: Marks) -> Text:
        """Return lines of the file, and what restores the stream's modes after each."""
        modes_after = self._modes_after if self._inside else None
        return Text(Between.from_marks(marks, 0, modes_after).output())

    def _dwell(self, dwell: Dwell) -> Iterator[OutputCommand]:
        action = dwell.action
        if isinstance(action, MoveAtRest):
            yield from self._move_at_rest(dwell, action)
            return
        releases = action.handling is Handling.RELEASE
        if releases and self._inside and (around := self._code.around(action)) is not None:
            assert self._at is not None
            assert action.end is not None
            before, after = around
            self.ledger.passed(action.filament)
            x, y, z, _ = action.end
            self._at = self._units.place((x, y, z, self.ledger.filament))
            yield LimitChange(b"%b%b\n%b" % (before, action.text, after))
            return
        if releases:
            yield self._release(action)
        if action.text or not releases:
            yield Text(action.text + b"\n")

    def _move_at_rest(self, dwell: Dwell, move: MoveAtRest) -> Iterator[OutputCommand]:
        yield from self._enter()
        assert self._at is not None
        start, (_, _, z, e) = self._at, self._units.place(move.end)
        self._at = start[X], start[Y], z, e
        self.ledger.moved([dwell.index], e - start[E])
        lifts = move.end[Z] != move.start[Z]
        yield PlacedMove(dwell, move.speed, move.acceleration, lifts, start, self._at)

    def _enter(self) -> Iterator[OutputCommand]:
        """Yield the change to the stream's limits if the user's hold, and a new count of E."""
        assert self._at is not None
        entering, self._inside = not self._inside, True
        if entering:
            begin = self._code.begin(self._offset, self._where)
            yield Text(text_of(begin))
        if entering or self.ledger.is_count_due():
            yield self._count()

    def _count(self) -> Text:
        """Return the line after which the firmware counts filament from 0, if it needs one."""
        return Text(self._code.reset_extruder(float(self._where[E])))

    @property
    def _where(self) -> Array:
        """Return the machine's place, (4,), mm."""
        assert self._at is not None
        return np.array(self._units.mm(self._at))

    def _release(self, action: Passthrough) -> LimitChange:
        end: list[bytes] = []
        if self._inside and self._at is not None:
            end = self._code.end(action.state, self._where)
        self._offset, self._inside, self._at = action.state.offset, False, None
        self.ledger.passed(action.filament)
        return LimitChange(text_of(end))
