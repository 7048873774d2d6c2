"""The machine as the stream has told it: where it stands, and what to tell it next."""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Iterator
from dataclasses import replace
from functools import partial

import numpy as np

from hframe_post.arrays import TS, Array, E, Flags, Integers, X, Z
from hframe_post.firmware.player import Dwelling, Player
from hframe_post.gcode.lexer import Line, command
from hframe_post.stream.types import Handling, Mark, Passthrough, Pause, Standing
from hframe_post.writers.stream.deferred import Output, carried
from hframe_post.writers.stream.filament_check import check_filament
from hframe_post.writers.stream.ledger import Ledger
from hframe_post.writers.stream.motion import Segments, Units, lines, segments, standing_line
from hframe_post.writers.stream.pace import Pace
from hframe_post.writers.stream.sample_buffer import Batch


class Machine:
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
        still = self._still
        made = segments(batch, self._at, still, self._player, self._units)
        self._still = made.still
        if len(made):
            yield from self._enter()
            yield from self._count_anew()
            made = yield from self._rejoined(made)
            e = np.append(self._at[E], made.at[:, E]) / self._units.per_mm[E]
            check_filament(batch, made.ends, e, still)
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
