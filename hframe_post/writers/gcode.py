"""Samples → a dense G-code stream.

The command becomes a polyline in time, with segments as the firmware wants them. Coordinates
are rounded to 0.001 mm, or finer if asked, and filament to 0.00001 mm, and written as differences
of rounded absolute values, so nothing is lost. The feed rate makes the firmware, which ramps
inside every segment, take just the segment's time; what it is late by, as far as rounding tells,
the next segments make up for. What happens at rest (retraction, lift, waiting) is one line at
standstill.

``held`` gathers samples into batches, ``motion`` makes segments and text of them, ``pace`` keeps
time, ``ledger`` counts; here is where the machine stands, and the order in which all is said.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from hframe_post.arrays import TS, Array, E, Flags, Integers, X, Z
from hframe_post.firmware.player import Dwelling, Player
from hframe_post.gcode.lexer import Line, command
from hframe_post.stream.types import Handling, Mark, Passthrough, Pause, Position, Samples, Standing
from hframe_post.writers.deferred import DeferredLine, Output, carried
from hframe_post.writers.filament_check import check_filament
from hframe_post.writers.held import SAMPLES_AT_ONCE, Batch, Held
from hframe_post.writers.ledger import Ledger
from hframe_post.writers.motion import Segments, Units, lines, segments, standing_line
from hframe_post.writers.pace import Pace


@dataclass(frozen=True, slots=True)
class GcodeSummary:
    """What was written: lines, those of motion in the busiest second, filament (mm)."""

    lines: int
    busiest_second: int
    filament: float

    def joined(self, later: GcodeSummary) -> GcodeSummary:
        """Of both together."""
        return GcodeSummary(
            self.lines + later.lines,
            max(self.busiest_second, later.busiest_second),
            self.filament + later.filament,
        )


class GcodeWriter:
    """Commands as text for a firmware.

    strategy: whose command is written; finer: digits that coordinates and F are given beyond
    those that a print needs. place, offset: where the stream goes on that another has begun: x,
    y, z, e, and the user's G92; a new stream finds the machine in the user's hands. steady: see
    ``Pace``.
    """

    def __init__(
        self,
        strategy: str,
        player: Player,
        finer: int = 0,
        place: Position | None = None,
        offset: tuple[float, float, float] = (0.0, 0.0, 0.0),
        steady: int = 0,
    ) -> None:
        units = Units.of(finer)
        at = units.rounded(np.array(place)) if place is not None else None
        self._strategy, self._lines = strategy, 0
        self._ledger = Ledger(int(at[E]) if at is not None else 0)
        self._machine = _Machine(player, self._ledger, units, at, offset, steady)
        self._held = Held()
        self._skip = 0  # samples of a pause that lie in the next chunks

    def write(self, chunks: Iterable[Samples]) -> Iterator[Output]:
        """The text, in order; ``summary`` tells of what has been asked for so far."""
        for output in self._outputs(chunks):
            self._lines += 1 if isinstance(output, DeferredLine) else output.count(b"\n")
            yield output

    @property
    def summary(self) -> GcodeSummary:
        """Of everything, once it has been written."""
        return GcodeSummary(self._lines, self._ledger.busiest, self._ledger.written)

    def _outputs(self, chunks: Iterable[Samples]) -> Iterator[Output]:
        yield from self._machine.go_on()
        for chunk in chunks:
            yield from self._chunk(chunk)
        yield from self._stop()
        yield from self._machine.take_back()

    def _chunk(self, chunk: Samples) -> Iterator[Output]:
        points = np.column_stack([chunk.commands[self._strategy], chunk.xyze[:, Z:]])
        done = min(self._skip, len(chunk))
        self._skip -= done
        for event in chunk.events:
            at = event.index - chunk.first
            if isinstance(event, Mark):
                yield from self._take(points[done:at], chunk.first + done)
                done = max(at, done)
                self._held.mark(event)
                if not self._held:
                    yield from self._carried(event.index)
            elif isinstance(event, Pause):
                yield from self._take(points[done:at], chunk.first + done)
                yield from self._stop(self._machine.passing(event))
                yield from self._machine.pause(event)
                done = min(at + event.samples, len(chunk))
                self._skip = at + event.samples - done
        yield from self._take(points[done:], chunk.first + done)

    def _take(self, points: Array, index: int) -> Iterator[Output]:
        if not len(points):
            return
        stand = self._machine.stand(points[0])
        self._held.take(points, index, stand)
        while len(self._held) > SAMPLES_AT_ONCE:
            if batch := self._held.batch(last=False):
                yield from self._machine.move(batch)

    def _stop(self, passing: float = 0.0) -> Iterator[Output]:
        """All that is held, up to standstill, or to a lift that begins at the speed ``passing``."""
        if batch := self._held.batch(last=True):
            yield from self._machine.move(batch, passing)
        if not passing:
            self._machine.stop()
        yield from self._carried()

    def _carried(self, index: int | None = None) -> Iterator[Output]:
        for mark in self._held.passing(index):
            yield from self._machine.carry(mark)


class _Machine:
    """Where the machine stands, as it was told, and what to tell it next."""

    def __init__(
        self,
        player: Player,
        ledger: Ledger,
        units: Units,
        at: Integers | None,
        offset: tuple[float, float, float],
        steady: int,
    ) -> None:
        self._player, self._ledger, self._units = player, ledger, units
        self._pace = Pace(player, units.per_feed, steady)
        self._at = at  # x, y, z, e, output units; None: only firmware knows
        self._feed = 0  # last F, output units; 0: to be told
        self._still = 0  # samples of standstill since the last segment
        self._may_be_elsewhere = False  # since the last motion, if it left some out
        self._inside = at is not None  # the stream's limits and modes are in force
        self._offset = offset  # of G92, while the machine is released
        self._after = b""  # a line that takes back what a retraction or lift has changed
        self._lift: Callable[[int], bytes] | None = None  # by its F, until motion goes on from it
        self._after_lift: list[Output] = []  # what is carried between

    def go_on(self) -> Iterator[Output]:
        """Where another stream ended, counting of filament begins anew."""
        if self._inside:
            yield self._player.reset_extruder()

    def take_back(self) -> Iterator[Output]:
        """What a retraction or lift has changed is as it was."""
        if self._after:
            yield self._after
        self._after = b""

    def stand(self, here: Array) -> Array:
        """Where the machine is, (4,), mm: ``here`` if only firmware knew.

        The filament is what was written: the first sample may have extruded on its way here.
        """
        if self._at is None:
            self._at = self._units.rounded(np.append(here[:E], self._ledger.filament))
        return np.asarray(self._at / self._units.per_mm)

    # ------------------------------------------------------------------ in motion

    def move(self, batch: Batch, passing: float = 0.0) -> Iterator[Output]:
        """Lines for a batch of samples. passing: speed at the end of the last one."""
        assert self._at is not None
        made = segments(batch, self._at, self._still, self._player, self._units)
        self._still = made.still
        if len(made):
            yield from self._enter()
            yield from self._count_anew()
            made = yield from self._rejoined(made)
            e = np.append(self._at[E], made.at[:, E]) / self._units.per_mm[E]
            check_filament(batch, made.ends, e)
            at = np.vstack([self._at, made.at])
            passes = passing and not self._still
            feeds = self._feeds(at, made, batch.last and not passes, passing or math.inf)
            yield from self._leave(feeds[0] / self._units.per_feed if not made.dwell[0] else 0.0)
            rows, ends = self._rows(at, feeds)
            self._ledger.moved(batch.first + made.ends, int(made.at[-1, E] - self._at[E]))
            self._at = made.at[-1]
            yield from self._interleaved(rows, ends, made, batch)
        else:
            for mark in batch.marks:
                yield from self.carry(mark)
        if batch.last and self._still:
            yield from self._leave(0.0)
            yield from self._dwell(self._still)
            self._still = 0
            self._pace.stop()

    def _rejoined(self, made: Segments) -> Generator[Output, None, Segments]:
        """At rest, where the machine may have left out moves: it comes to where this is.

        Returns the segments that are left, the first of them shorter by the way and the time.
        """
        assert self._at is not None
        at, per_mm = self._at / self._units.per_mm, self._units.per_mm[:Z]
        way = (made.at[0, :Z] - self._at[:Z]) / per_mm
        if (
            not self._may_be_elsewhere
            or not self._pace.stands
            or np.abs(way).max() < 1.5 / per_mm[X]
        ):
            return made
        self._may_be_elsewhere = False
        if (rejoined := self._player.rejoin(at, way, float(made.T[0]))) is None:
            return made
        self._at, self._feed = self._units.rounded(rejoined.at), 0
        self._pace.moves(rejoined.speed)
        yield rejoined.text
        T = made.T.copy()
        T[0] -= rejoined.seconds
        return replace(made, T=T)

    def _feeds(self, at: Integers, made: Segments, last: bool, after: float) -> Integers:
        """F of the segments. last: whether the machine stands after them; after: speed there."""
        rest: Flags = np.append(made.dwell > 0, last)
        return self._pace.feeds(at / self._units.per_mm, made.T, rest, after)

    def _rows(self, at: Integers, feeds: Integers) -> tuple[bytes, Integers]:
        """G1 lines from place to place, at (k + 1, 4), and where each ends in their text."""
        shown = np.diff(at, axis=0) != 0
        shown[0, :Z] |= self._feed == 0  # after the machine was released: both, to be plain
        faster = np.diff(feeds, prepend=self._feed) != 0
        self._feed = int(feeds[-1])
        return lines(at, feeds, shown, faster, self._units)

    def _interleaved(
        self, rows: bytes, ends: Integers, made: Segments, batch: Batch
    ) -> Iterator[Output]:
        """The rows with the lines and dwells that stand between them."""
        before = np.searchsorted(made.ends, batch.marked, side="right").tolist()
        between = [(1, self.take_back())]
        between += [(row, self.carry(m)) for row, m in zip(before, batch.marks, strict=True)]
        still = np.flatnonzero(made.dwell)
        between += [(k, self._dwell(int(made.dwell[k]))) for k in still.tolist()]
        written = 0
        for row, outputs in sorted(between, key=lambda item: item[0]):
            end = int(ends[row - 1]) if row else 0
            if end > written:
                yield rows[written:end]
                written = end
            yield from outputs
        yield rows[written:]

    def carry(self, mark: Mark) -> Iterator[Output]:
        """A line of the file, in mid-motion; modes of the stream stay."""
        outputs: list[Output] = [carried(mark.text, mark.index * TS)]
        self._may_be_elsewhere |= self._player.labels_object(mark.text)
        if self._inside and (coded := command(Line(0, mark.text))) is not None:
            outputs.append(self._player.modes_after(coded.name))
        if self._lift is None:
            yield from outputs
        else:
            self._after_lift += outputs

    # ------------------------------------------------------------------ at standstill

    def stop(self) -> None:
        """The machine stands."""
        self._pace.stop()

    def passing(self, pause: Pause) -> float:
        """Speed at which motion passes into it, mm/s; 0: from rest."""
        if not pause.entry or not isinstance(pause.action, Standing):
            return 0.0
        places = np.array([pause.action.start, pause.action.end])
        return self._player.lift_corner(places, pause.action.speed)

    def pause(self, pause: Pause) -> Iterator[Output]:
        """What is done at rest."""
        yield from self._leave(0.0)
        action = pause.action
        if isinstance(action, Standing):
            yield from self._standing(pause, action)
            return
        if action.handling is Handling.RELEASE:
            yield from self._release(action)
        if action.text or action.handling is not Handling.RELEASE:
            yield action.text + b"\n"
            self._may_be_elsewhere |= self._player.labels_object(action.text)

    def _standing(self, pause: Pause, move: Standing) -> Iterator[Output]:
        """Retraction or lift: one line."""
        lifts = move.end[Z] != move.start[Z]
        yield from self._enter()
        if self._pace.stands or not pause.entry:
            self._pace.stop()
            yield from self._dwell(0, Dwelling.BEFORE_LIFT if lifts else Dwelling.BEFORE_RETRACTION)
        yield from self._count_anew()
        assert self._at is not None
        end = np.concatenate([self._at[:Z], self._units.rounded(np.array(move.end))[Z:]])
        places = np.stack([self._at, end]) / self._units.per_mm
        stroke = self._pace.stroke(places, pause, move.speed)
        if stroke.after and not self._after:
            yield stroke.before
            self._after = stroke.after
        self._ledger.moved(np.array([pause.index]), int(end[E] - self._at[E]))
        line = partial(standing_line, self._at, end, units=self._units)
        self._at = end
        if pause.leaving:
            self._lift = line
            return
        self._feed = round(stroke.speed * self._units.per_feed)
        yield line(self._feed)
        yield from self._dwell(0, Dwelling.AFTER_LIFT if lifts else Dwelling.AFTER_RETRACTION)

    def _leave(self, speed: float) -> Iterator[Output]:
        """A lift passes into motion at that speed, which decides how fast it was to be."""
        if self._lift is None:
            return
        line, self._lift = self._lift, None
        self._feed = round(self._pace.leave(speed).speed * self._units.per_feed)
        yield line(self._feed)
        yield from self._after_lift
        self._after_lift = []

    def _release(self, action: Passthrough) -> Iterator[Output]:
        """The machine is the user's again, limits, modes and all."""
        if self._inside and self._at is not None:
            end = self._player.end(action.state, self._at / self._units.per_mm)
            yield b"".join(line + b"\n" for line in end)
        self._offset = action.state.offset
        self._inside, self._at, self._feed, self._after = False, None, 0, b""
        self._pace.begin()
        self._ledger.passed(action.filament)

    def _dwell(self, samples: int, beside: Dwelling = Dwelling.MOTION) -> Iterator[Output]:
        if self._inside and (line := self._pace.dwell(samples, beside)):
            yield line

    def _count_anew(self) -> Iterator[Output]:
        """Lets the firmware count filament from nothing, where it has counted much."""
        if self._ledger.counts_anew():
            yield self._player.reset_extruder()

    def _enter(self) -> Iterator[Output]:
        """Takes the machine over, if it is not in our hands."""
        if not self._inside and self._at is not None:
            self._inside = True
            begin = self._player.begin(self._offset, self._at / self._units.per_mm)
            yield b"".join(line + b"\n" for line in begin)
