"""Samples → a dense G-code stream.

The command becomes a polyline in time, with segments as the firmware wants them. Coordinates
are rounded to 0.001 mm, or finer if asked, and filament to 0.00001 mm, and written as differences
of rounded absolute values, so nothing is lost. The feed rate makes the firmware, which ramps
inside every segment, take just the segment's time; what it is late by, as far as rounding tells,
the next segments make up for. What happens at rest (retraction, lift, waiting) is one line at
standstill.

``held`` gathers samples into batches, ``motion`` makes segments and text of them, ``pace`` keeps
time, ``ledger`` counts, ``machine`` knows where the machine stands; here is the order in which
all is said.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from hframe_post.arrays import Array, E, Z
from hframe_post.firmware.player import Player
from hframe_post.stream.types import Mark, Pause, Position, Samples
from hframe_post.writers.stream.deferred import DeferredLine, Output
from hframe_post.writers.stream.ledger import Ledger
from hframe_post.writers.stream.machine import Machine
from hframe_post.writers.stream.motion import Units
from hframe_post.writers.stream.sample_buffer import SAMPLES_AT_ONCE, Held


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
        self._machine = Machine(player, self._ledger, units, at, offset, steady)
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
