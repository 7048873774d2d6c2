"""Samples → segments and moves at rest, by where the machine is and whose limits hold."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from hframe_post.arrays import TS, Array, E, X, Y, Z
from hframe_post.firmware.code import Code
from hframe_post.firmware.motion import MotionRules, Way
from hframe_post.gcode.commands import Line, name_and_arguments
from hframe_post.prediction.predict import Played
from hframe_post.stream.marks import Marks, recent
from hframe_post.stream.types import (
    Dwell,
    Handling,
    MoveAtRest,
    Passthrough,
    Samples,
    SlowStraight,
)
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
from hframe_post.writers.page import NOTHING_BETWEEN, Between, PlacedMove
from hframe_post.writers.timing import Motion, Timing


class Machine:
    """The machine's place, and whether the stream's limits and modes hold.

    at: where another stream ended; None: only firmware knows. offset: of G92, while the machine is
    released. played: notes the motion in x and y.
    """

    def __init__(
        self, strategy: str, rules: MotionRules, code: Code, units: Units, at: Place | None,
        offset: tuple[float, float, float], timing: Timing, played: Played | None = None,
    ) -> None:  # fmt: skip
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
        self._timing, self._page, self._played = timing, timing.page, played
        self._filament = Filament(at[E] if at is not None else 0)
        if self._inside:
            self._count()

    @property
    def filament(self) -> float:
        """Return the filament so far, mm."""
        return self._filament.written

    def finish(self) -> None:
        """Write what is left."""
        self._stop()
        self._page.finish()

    def write(self, chunk: Samples) -> None:
        """Write the next samples, as far as they do not wait for others."""
        self._skip = max(self._skip - (chunk.first - self._end), 0)  # those left out
        self._end = chunk.end
        done = min(self._skip, len(chunk))
        self._skip -= done
        for event in chunk.events:
            at = event.index - chunk.first
            if isinstance(event, Marks):
                self._take(chunk, done, at)
                done = max(at, done)
                self._buffer.add_marks(event)
                if not self._buffer:
                    self._marks(chunk.first + done)
            elif isinstance(event, Dwell):
                self._take(chunk, done, at)
                self._stop(self._speed_into(event))
                self._dwell(event)
                done = min(at + event.samples, len(chunk))
                self._skip = at + event.samples - done
            elif isinstance(event, SlowStraight):
                self._take(chunk, done, at)
                done = max(at, done)
                self._slow_straight(event)
        self._take(chunk, done, len(chunk))
        if self._played is not None:
            self._played.until = chunk.end - len(self._buffer) - self._still

    def _slow_straight(self, slow: SlowStraight) -> None:
        """Write a straight whose samples are left out, as one segment."""
        if batch := self._buffer.batch(last=False):
            self._motion(batch)
        assert self._at is not None
        start, end = self._at, self._units.place(slow.end)
        self._buffer.resume(slow.end)
        self._still += slow.samples
        if end == start:
            return
        self._enter()
        self._filament.steps += end[E] - start[E]
        self._at = end
        at, T = np.array([start, end]), np.array([self._still * TS])
        self._still = 0
        due = np.array([slow.index + slow.samples - 1])
        self._timing.motion(Motion(at, T, np.zeros(1, np.int64), due, NOTHING_BETWEEN))

    def _take(self, chunk: Samples, start: int, stop: int) -> None:
        if start >= stop:
            return
        xy, xyze = chunk.commands[self._strategy], chunk.xyze
        if self._at is None:  # the first sample may have extruded on its way here
            (x, y), z = xy[start].tolist(), float(xyze[start, Z])
            self._at = self._units.place((x, y, z, self._filament.total))
        here = self._units.mm(self._at)
        while start < stop:
            if len(self._buffer) == SAMPLES_AT_ONCE and (batch := self._buffer.batch(last=False)):
                self._motion(batch)
            rows = slice(start, stop)
            ahead = chunk.advance[rows, 0] if chunk.advance is not None and chunk.in_e else None
            start += self._buffer.add(xy[rows], xyze[rows], ahead, chunk.first + start, here)

    def _stop(self, speed: float = 0.0) -> None:
        """Write what is buffered, up to rest or to a lift that begins at a speed, mm/s."""
        if batch := self._buffer.batch(last=True):
            self._motion(batch, speed)
        if not speed:
            self._timing.stop()
        self._marks()

    def _marks(self, index: int | None = None) -> None:
        if marks := self._buffer.marks_up_to(index):
            self._pass_on(marks)

    def _speed_into(self, dwell: Dwell) -> float:
        """Return the speed, mm/s, at which motion passes into a dwell; 0: it stops."""
        if not isinstance(move := dwell.action, MoveAtRest):
            return 0.0
        way, planned = Way(move.start, move.end, move.acceleration), (dwell.entry, dwell.leaving)
        return self._rules.corners(way, move.speed, planned)[0]

    def _motion(self, batch: Batch, speed: float = 0.0) -> None:
        """Write a batch, whose motion may end at a speed, mm/s."""
        assert self._at is not None
        still = self._still
        made = segments(batch, self._at, still, self._rules, self._units)
        self._still = made.still
        if len(made.T):
            self._enter()
            if self._played is not None:
                end = batch.first - 1 + made.ends
                begin = end - np.rint(made.T / TS).astype(np.int64)
                self._played.add(begin, end, made.at / self._units.per_mm)
            between = self._between(batch, made, still) if batch.marks else NOTHING_BETWEEN
            stops = batch.last and not (speed and not self._still)
            x, y, z, e = made.at[-1].tolist()
            self._filament.steps += e - self._at[E]
            self._at, due = (x, y, z, e), batch.first + made.ends
            motion = Motion(made.at, made.T, made.dwell, due, between, stops, speed or math.inf)
            self._timing.motion(motion)
        elif batch.marks:
            self._pass_on(batch.marks)
        if batch.last and self._still:
            self._timing.stop(self._still if self._inside else 0)
            self._still = 0

    def _between(self, batch: Batch, made: Segments, still: int) -> Between:
        """Return the lines of the file in a batch, among its segments."""
        check_filament(batch, made.ends, made.at[:, E] / self._units.per_mm[E], still)
        return Between.from_marks(batch.marks, rows_before(batch, made.ends), self._modes_after)

    def _pass_on(self, marks: Marks) -> None:
        """Write lines of the file, and what restores the stream's modes after each."""
        modes_after = self._modes_after if self._inside else None
        self._page.add_lines(Between.from_marks(marks, 0, modes_after))

    def _dwell(self, dwell: Dwell) -> None:
        action = dwell.action
        if isinstance(action, MoveAtRest):
            self._move_at_rest(dwell, action)
            return
        releases = action.handling is Handling.RELEASE
        if releases and self._inside and (around := self._code.around(action)) is not None:
            assert self._at is not None
            assert action.end is not None
            before, after = map(text_of, around)
            self._filament.passed += action.filament
            x, y, z, _ = action.end
            self._at = self._units.place((x, y, z, self._filament.total))
            self._timing.change_limits(b"%b%b\n%b" % (before, action.text, after))
            return
        if releases:
            self._release(action)
        if action.text or not releases:
            self._page.add_lines(action.text + b"\n")

    def _move_at_rest(self, dwell: Dwell, move: MoveAtRest) -> None:
        self._enter()
        assert self._at is not None
        start, (_, _, z, e) = self._at, self._units.place(move.end)
        self._at = start[X], start[Y], z, e
        self._filament.steps += e - start[E]
        lifts = move.end[Z] != move.start[Z]
        self._timing.stroke(
            PlacedMove(dwell, move.speed, move.acceleration, lifts, start, self._at)
        )

    def _enter(self) -> None:
        """Change to the stream's limits if the user's hold, and begin a new count of E."""
        assert self._at is not None
        entering, self._inside = not self._inside, True
        if entering:
            self._page.add_lines(text_of(self._code.begin(self._offset, self._where)))
        if self._filament.is_count_due() or entering:
            self._count()

    def _count(self) -> None:
        """Let the firmware count filament from 0, if it needs that."""
        self._page.add_lines(self._code.reset_extruder(float(self._where[E])))

    @property
    def _where(self) -> Array:
        """Return the machine's place, (4,), mm."""
        assert self._at is not None
        return np.array(self._units.mm(self._at))

    def _release(self, action: Passthrough) -> None:
        end: list[str] = []
        if self._inside and self._at is not None:
            end = self._code.end(action.state, self._where)
        self._offset, self._inside, self._at = action.state.offset, False, None
        self._filament.passed += action.filament
        self._timing.change_limits(text_of(end))


@dataclass(slots=True)
class Filament:
    """Filament of a stream: in units of E, and mm in lines passed on.

    begun: units of E where the stream begins.
    """

    begun: int
    steps: int = field(init=False)
    counted: int = field(init=False)  # when the firmware last began to count
    passed: float = 0.0

    def __post_init__(self) -> None:
        self.steps = self.counted = self.begun

    def is_count_due(self) -> bool:
        """Return whether the firmware should count from 0, at least every 2 mm of filament.

        Marlin adds up E in floats of 32 bits, whose errors grow with the sum.
        """
        due = abs(self.steps - self.counted) > 200_000
        if due:
            self.counted = self.steps
        return due

    @property
    def total(self) -> float:
        """Return all filament since the print began, mm."""
        return self.steps / 1e5 + self.passed

    @property
    def written(self) -> float:
        """Return the filament of this stream, mm."""
        return (self.steps - self.begun) / 1e5 + self.passed


def text_of(lines: Iterable[str]) -> bytes:
    """Return lines as a text."""
    return "".join(f"{line}\n" for line in lines).encode()
