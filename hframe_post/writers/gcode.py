"""Samples → a dense G-code stream.

The command becomes a polyline in time, with segments as the firmware wants them. Coordinates
are rounded to 0.001 mm, or finer if asked, and filament to 0.00001 mm, and written as differences
of rounded absolute values, so nothing is lost. The feed rate makes the firmware, which ramps
inside every segment, take just the segment's time; what it is late by, as far as rounding tells,
the next segments make up for. What happens at rest (retraction, lift, waiting) is one line at
standstill.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from hframe_post.arrays import TS, Array, E, Flags, Integers, Z
from hframe_post.firmware.decimate import LONGEST
from hframe_post.firmware.player import Dwelling, Player, plain
from hframe_post.gcode.lexer import Line, command
from hframe_post.stream.types import Handling, Mark, Pause, Samples, Standing
from hframe_post.writers import digits

PER_SECOND = round(1.0 / TS)
SAMPLES_AT_ONCE = 2048 * LONGEST
DWELL = 24  # samples; a longer standstill is a dwell, a shorter one joins the next segment
COUNTED = 5_000_000  # units of filament after which some firmware must count anew
CATCH_UP = 0.01  # share of a batch's time by which it may be hurried or delayed
DECIMALS = (3, 3, 3, 5)  # of x, y, z, e in mm
PER_MM_E = 1e5  # output units of e
FEED_DECIMALS = 1  # of F in mm/min
ELAPSED = re.compile(rb";\s*TIME_ELAPSED:")
TOTAL = re.compile(rb";\s*TIME:\s*\d|[Mm]73\s|; estimated printing time \(normal mode\) =")


@dataclass(frozen=True, slots=True)
class DeferredLine:
    """A line that tells of the whole print's duration, which is known only at the end."""

    line: bytes
    elapsed: float


Output = bytes | DeferredLine


@dataclass(frozen=True, slots=True)
class GcodeSummary:
    """What was written: lines, those of motion in the busiest second, filament (mm)."""

    lines: int
    busiest_second: int
    filament: float


class _Ledger:
    """Filament in steps of 0.00001 mm, and mm in lines passed on; lines of motion a second."""

    def __init__(self) -> None:
        self.steps, self.passed, self.busiest = 0, 0.0, 0
        self._second, self._lines = 0, 0  # lines in that second, so far

    def wrote(self, samples: Integers) -> None:
        """Counts lines by the samples, ascending, at which they are due."""
        for second, count in zip(
            *np.unique(samples // PER_SECOND, return_counts=True), strict=True
        ):
            self._lines = int(count) + (self._lines if second == self._second else 0)
            self._second, self.busiest = int(second), max(self.busiest, self._lines)

    @property
    def filament(self) -> float:
        """All of it, mm."""
        return self.steps / PER_MM_E + self.passed


class GcodeWriter:
    """Commands as text for a firmware.

    strategy: whose command is written; finer: digits that coordinates and F are given beyond
    those that a print needs.
    """

    def __init__(self, strategy: str, player: Player, finer: int = 0) -> None:
        self._ledger, self._lines = _Ledger(), 0
        self._stream = _Stream(strategy, player, self._ledger, finer)

    def write(self, chunks: Iterable[Samples]) -> Iterator[Output]:
        """The text, in order; ``summary`` tells of what has been asked for so far."""
        for output in self._outputs(chunks):
            self._lines += 1 if isinstance(output, DeferredLine) else output.count(b"\n")
            yield output

    def _outputs(self, chunks: Iterable[Samples]) -> Iterator[Output]:
        for chunk in chunks:
            yield from self._stream.chunk(chunk)
        yield from self._stream.span(last=True)

    @property
    def summary(self) -> GcodeSummary:
        """Of everything, once it has been written."""
        return GcodeSummary(self._lines, self._ledger.busiest, self._ledger.filament)


class _Stream:
    """Where the machine stands in output units, and the samples not written yet."""

    def __init__(self, strategy: str, player: Player, ledger: _Ledger, finer: int) -> None:
        self._strategy, self._player, self._ledger = strategy, player, ledger
        self._decimals = (*(decimals + finer for decimals in DECIMALS[:E]), DECIMALS[E])
        self._per_mm = 10.0 ** np.array(self._decimals)
        self._feed_decimals = FEED_DECIMALS + finer
        self._per_feed = 60.0 * 10.0**self._feed_decimals  # units of F in a mm/s
        self._counted = 0  # of the ledger's steps, when the firmware last began to count
        self._inside = False  # the stream's limits and modes are in force
        self._at: Integers | None = None  # x, y, z, e as last written; None: only firmware knows
        self._offset = (0.0, 0.0, 0.0)  # of G92, while the machine is yielded
        self._feed = 0  # last F, in its output units
        self._before = 0.0  # speed of the last segment, mm/s
        self._still = 0  # samples of standstill since the last segment
        self._lag = 0.0  # s by which the machine lags, as far as rounding tells
        self._start: Array = np.zeros(4)  # the point before the held ones
        self._held: list[Array] = []
        self._count = 0
        self._index = 0  # of the first held sample
        self._marks: list[Mark] = []
        self._skip = 0  # samples of a pause that lie in the next chunks

    # ------------------------------------------------------------------ samples in

    def chunk(self, chunk: Samples) -> Iterator[Output]:
        """Takes a chunk; yields what can be written."""
        points = np.column_stack([chunk.commands[self._strategy], chunk.xyze[:, Z:]])
        done = min(self._skip, len(chunk))
        self._skip -= done
        for event in chunk.events:
            at = event.index - chunk.first
            if isinstance(event, Mark):
                yield from self._take(points[done:at], chunk.first + done)
                done = max(at, done)
                self._marks.append(event)
                if not self._count:
                    yield from self._carried(event.index)
            elif isinstance(event, Pause):
                yield from self._take(points[done:at], chunk.first + done)
                yield from self.span(last=True)
                yield from self._pause(event)
                done = min(at + event.samples, len(chunk))
                self._skip = at + event.samples - done
        yield from self._take(points[done:], chunk.first + done)

    def _take(self, points: Array, index: int) -> Iterator[Output]:
        if not len(points):
            return
        if self._at is None:
            self._at = np.rint(points[0] * self._per_mm).astype(np.int64)
        if not self._count:
            self._index, self._start = index, self._at / self._per_mm
        self._held.append(points)
        self._count += len(points)
        while self._count > SAMPLES_AT_ONCE:
            yield from self.span(last=False)

    # ------------------------------------------------------------------ segments out

    def span(self, last: bool) -> Iterator[Output]:
        """The held samples as segments: a batch of them, or all up to a standstill."""
        if self._count:
            held = np.concatenate(self._held)
            n = len(held) if last else SAMPLES_AT_ONCE
            points = np.vstack([self._start, held[:n]])
            marks = [mark for mark in self._marks if mark.index - self._index < n]
            yield from self._segments(points, marks, last)
            self._marks = self._marks[len(marks) :]
            self._held, self._count = [held[n:]], len(held) - n
            self._start, self._index = points[-1], self._index + n
        if last:
            self._held, self._count, self._before = [], 0, 0.0
            yield from self._carried(self._index)

    def _segments(self, points: Array, marks: list[Mark], last: bool) -> Iterator[Output]:
        """Lines for points (n + 1, 4), of which the first is written already."""
        assert self._at is not None
        n = len(points) - 1
        after = np.array([mark.index - self._index + 1 for mark in marks], dtype=np.int64)
        forced = np.zeros(n + 1, dtype=bool)
        forced[after] = True
        ends, places = self._player.segments(points, forced, last)
        at = np.rint(places * self._per_mm).astype(np.int64)
        moved = np.any(np.diff(at[:, :E], axis=0, prepend=self._at[None, :E]) != 0, axis=1)
        starts, ends, at = np.concatenate([[0], ends])[:-1][moved], ends[moved], at[moved]
        idle = starts - np.concatenate([[-self._still], ends])[: len(ends)]
        dwells = np.where(idle >= DWELL, idle, 0)
        T = (ends - starts + idle - dwells) * TS
        rows_before = np.searchsorted(ends, after, side="right").tolist()
        insertions = list(zip(rows_before, marks, strict=True))
        self._still = n - int(ends[-1]) if len(ends) else self._still + n
        if len(ends):
            yield from self._enter()
            yield from self._count_anew()
            self._ledger.wrote(self._index + ends)
            rows, row_ends = self._rows(at, T, dwells > 0, last)
            yield from self._interleaved(rows, row_ends, dwells, insertions)
        else:
            for mark in marks:
                yield from self._line(mark)
        if last and self._still:
            yield from self._dwell(self._still)
            self._still = 0

    def _rows(self, at: Integers, T: Array, dwell: Flags, last: bool) -> tuple[bytes, Integers]:
        """G1 lines to the positions ``at`` (k, 4), and where each ends in their text."""
        delta = np.diff(at, axis=0, prepend=self._at[None])  # type: ignore[index]
        rest = np.concatenate([dwell, [last]])
        rest[0] |= self._before == 0.0
        mm = np.vstack([self._at, at]) / self._per_mm  # type: ignore[list-item]
        T = self._player.least_times(mm, T)
        hurried = T * (1.0 - np.clip(self._lag / T.sum(), -CATCH_UP, CATCH_UP))
        v = self._player.feed_rates(mm, hurried, rest, self._before)
        feed = np.maximum(np.rint(v * self._per_feed), 1.0).astype(np.int64)
        taken = self._player.durations(mm, feed / self._per_feed, rest, self._before)
        self._lag += float((taken - T).sum())
        shown = delta != 0
        shown[0, :Z] |= self._feed == 0  # after the machine was yielded: both, to be plain
        faster = np.diff(feed, prepend=self._feed) != 0
        words = [
            digits.word(
                letter,
                at[:, axis] if axis != E else delta[:, E],
                self._decimals[axis],
                shown[:, axis],
            )
            for axis, letter in enumerate((b" X", b" Y", b" Z", b" E"))
        ]
        self._at, self._feed, self._before = at[-1], int(feed[-1]), float(v[-1])
        self._ledger.steps += int(delta[:, E].sum())
        return digits.lines(b"G1", [*words, digits.word(b" F", feed, self._feed_decimals, faster)])

    def _interleaved(
        self, rows: bytes, ends: Integers, dwells: Integers, marks: list[tuple[int, Mark]]
    ) -> Iterator[Output]:
        """The rows with the lines that stand between them."""
        between = [(row, mark) for row, mark in marks]
        between += [(int(row), None) for row in np.flatnonzero(dwells)]  # type: ignore[misc]
        written = 0
        for row, mark in sorted(between, key=lambda item: item[0]):
            end = int(ends[row - 1]) if row else 0
            if end > written:
                yield rows[written:end]
                written = end
            yield from self._line(mark) if mark else self._dwell(int(dwells[row]))
        yield rows[written:]

    def _carried(self, index: int) -> Iterator[Output]:
        """Marks up to a sample, at standstill."""
        while self._marks and self._marks[0].index <= index:
            yield from self._line(self._marks.pop(0))

    def _line(self, mark: Mark) -> Iterator[Output]:
        """A carried line; what it tells of time is told anew, modes of the stream stay."""
        elapsed = mark.index * TS
        if ELAPSED.match(mark.text):
            yield b";TIME_ELAPSED:%.6f\n" % elapsed
        elif TOTAL.match(mark.text):
            yield DeferredLine(mark.text, elapsed)
        else:
            yield mark.text + b"\n"
        if self._inside and (coded := command(Line(0, mark.text))) is not None:
            yield self._player.modes_after(coded.name)

    # ------------------------------------------------------------------ at standstill

    def _pause(self, pause: Pause) -> Iterator[Output]:
        action = pause.action
        if isinstance(action, Standing):
            lifts = action.end[Z] != action.start[Z]
            yield from self._enter()
            yield from self._dwell(0, Dwelling.BEFORE_LIFT if lifts else Dwelling.MOTION)
            yield from self._count_anew()
            self._ledger.wrote(np.array([pause.index]))
            yield from self._standing(action)
            self._lag += pause.exact - pause.samples * TS
            yield from self._dwell(0, Dwelling.AFTER_LIFT if lifts else Dwelling.MOTION)
        elif action.handling is Handling.RELEASE:
            if self._inside and self._at is not None:
                end = self._player.end(action.state, self._at / self._per_mm)
                yield b"".join(line + b"\n" for line in end)
            self._offset = action.state.offset
            self._inside, self._at, self._feed, self._lag = False, None, 0, 0.0
            self._ledger.passed += action.filament
            if action.text:
                yield action.text + b"\n"
        else:
            yield action.text + b"\n"

    def _standing(self, move: Standing) -> Iterator[Output]:
        """Retraction or lift: one line."""
        assert self._at is not None
        to = np.rint(np.array(move.end) * self._per_mm).astype(np.int64)
        dz, de = int(to[Z] - self._at[Z]), int(to[E] - self._at[E])
        self._at = np.concatenate([self._at[:Z], to[Z:]])
        self._feed = round(move.speed * self._per_feed)
        self._ledger.steps += de
        if dz or de:
            z = f" Z{plain(to[Z] / self._per_mm[Z], self._decimals[Z])}" if dz else ""
            e = f" E{plain(de / self._per_mm[E], self._decimals[E])}" if de else ""
            feed = plain(60.0 * self._feed / self._per_feed, self._feed_decimals)
            yield f"G1{z}{e} F{feed}\n".encode()

    def _dwell(self, samples: int, beside: Dwelling = Dwelling.MOTION) -> Iterator[Output]:
        """Standstill for so long, less what the machine is late."""
        seconds = samples * TS - self._lag
        waiting = self._player.dwell(seconds, beside) if self._inside else None
        if waiting is not None:
            line, waited = waiting
            yield line
            self._lag += waited - samples * TS

    def _count_anew(self) -> Iterator[Output]:
        """Lets the firmware count filament from nothing, where it has counted much."""
        if abs(self._ledger.steps - self._counted) > COUNTED:
            self._counted = self._ledger.steps
            yield self._player.reset_extruder()

    def _enter(self) -> Iterator[Output]:
        """Takes the machine over, if it is not in our hands."""
        if not self._inside and self._at is not None:
            self._inside = True
            begin = self._player.begin(self._offset, self._at / self._per_mm)
            yield b"".join(line + b"\n" for line in begin)
