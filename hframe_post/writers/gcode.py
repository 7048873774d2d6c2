"""Samples → a dense G-code stream.

The command becomes a polyline in time, with segments as the firmware wants them. Coordinates
are rounded to 0.001 mm, or finer if asked, and filament to 0.00001 mm, and written as differences
of rounded absolute values, so that no rounding adds up. Feed rates allow for the firmware's ramps
inside every segment, so that it takes the segment's time; the next segments make up for what it
is late by, as far as rounding tells. A retraction, a lift or a wait is one line at rest.

Three modules make the text, each of which calls the next:

1. ``machine``: samples → segments, retractions, lifts and dwells, with places in output units;
2. ``timing``: feed rates and dwells, which keep the machine in time;
3. ``page``: rows of numbers → lines of G-code, many at once.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

from hframe_post.firmware.code import Code
from hframe_post.firmware.motion import MotionRules
from hframe_post.prediction.predict import Played
from hframe_post.stream.tally import tallied
from hframe_post.stream.types import Position, Samples
from hframe_post.writers.decimation import Units
from hframe_post.writers.machine import Machine
from hframe_post.writers.print_time import Output
from hframe_post.writers.timing import Timing


@dataclass(frozen=True, slots=True)
class GcodeSummary:
    """Numbers of a stream: lines, lines of motion in the busiest second, filament (mm).

    late: seconds by which the machine takes longer than the samples.
    """

    lines: int = 0
    busiest_second: int = tallied(0, max)
    filament: float = 0.0
    late: float = 0.0


class GcodeWriter:
    """Writer of one stream for a firmware.

    strategy: whose command is written; finer: digits of coordinates and F beyond those that a
    print needs. place, offset: x, y, z, e and the user's G92 where this stream continues another;
    without a place the machine is under the user's limits. steady: see ``Timing``. played: notes
    the motion.
    """

    def __init__(
        self,
        strategy: str,
        rules: MotionRules,
        code: Code,
        finer: int = 0,
        place: Position | None = None,
        offset: tuple[float, float, float] = (0.0, 0.0, 0.0),
        steady: int = 0,
        played: Played | None = None,
    ) -> None:
        units = Units(finer)
        at = units.place(place) if place is not None else None
        self._timing = Timing(rules, units, steady)
        self._machine = Machine(strategy, rules, code, units, at, offset, self._timing, played)

    def write(self, chunks: Iterable[Samples]) -> Iterator[Output]:
        """Yield the text in order; ``summary`` counts what was yielded so far."""
        for chunk in chunks:
            if text := self.take(chunk):
                yield text
        yield self.finish()

    def take(self, chunk: Samples) -> Output:
        """Return the text that can be written with the next chunk, often none."""
        page = self._timing.page
        self._machine.write(chunk)
        return page.text() if page.is_long and not self._timing.waits else b""

    def finish(self) -> Output:
        """Return the text that is left."""
        self._machine.finish()
        return self._timing.page.text()

    @property
    def summary(self) -> GcodeSummary:
        """Return the numbers of the whole stream, once it has been written."""
        page, timing = self._timing.page, self._timing
        late = timing.lost + timing.lag
        return GcodeSummary(page.lines, page.busiest, self._machine.filament, late)


def rehearsed(chunks: Iterable[Samples], writers: Sequence[GcodeWriter]) -> Iterator[Samples]:
    """Yield the chunks unchanged, once each was written by writers whose text is dropped."""
    for chunk in chunks:
        for writer in writers:
            writer.take(chunk)
        yield chunk
    for writer in writers:
        writer.finish()


def as_written(
    chunks: Iterable[Samples], strategies: Iterable[str], rules: MotionRules, code: Code
) -> Iterator[Samples]:
    """Yield the chunks with the motion that lines would make of the commands of strategies."""
    played, waiting = [Played(name) for name in strategies], deque[Samples]()
    writers = [GcodeWriter(each.strategy, rules, code, played=each) for each in played]

    def ready(until: float) -> Iterator[Samples]:
        while waiting and waiting[0].end <= until:
            chunk = waiting.popleft()
            for each in played:
                chunk = each.motion(chunk)
            yield chunk

    for chunk in rehearsed(chunks, writers):
        waiting.append(chunk)
        yield from ready(min(each.until for each in played))
    yield from ready(math.inf)
