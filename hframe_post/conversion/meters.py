"""What the stages do not count themselves: each meter lets the stream pass and sums it up."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from hframe_post.arrays import E
from hframe_post.model.plant import Plant
from hframe_post.prediction.predict import judge
from hframe_post.prediction.statistics import ContourErrors
from hframe_post.stream.chunks import stretches
from hframe_post.stream.types import Item, Moves, Passthrough, Pause, Rest, Samples, Standing

RETRACTION = re.compile(rb"\s*G1[01]\s*(;.*)?$", re.IGNORECASE)
JUDGED_EVERY = 2  # samples; 500 Hz is far above what a printer rings at


@dataclass(frozen=True, slots=True)
class InputSummary:
    """What a file holds: lines, moves at known places, filament (mm).

    firmware_retractions: G10 and G11 that pass, of which only the firmware knows what they do.
    """

    lines: int = 0
    moves: int = 0
    filament: float = 0.0
    firmware_retractions: int = 0


class InputMeter:
    """Counts what is read."""

    def __init__(self) -> None:
        self._lines, self._moves, self._filament, self._retractions = 0, 0, 0.0, 0

    def lines(self, lines: Iterable[bytes]) -> Iterator[bytes]:
        """The lines of the file."""
        for self._lines, line in enumerate(lines, 1):
            yield line

    def items(self, items: Iterable[Item]) -> Iterator[Item]:
        """What the reader made of them."""
        for item in items:
            if isinstance(item, Moves):
                self._moves += len(item.line)
                self._filament += float(item.points[-1, E] - item.points[0, E])
            elif isinstance(item, Standing):
                self._moves += 1
                self._filament += item.end[E] - item.start[E]
            else:
                self._filament += item.filament
                self._retractions += RETRACTION.match(item.text) is not None
            yield item

    @property
    def summary(self) -> InputSummary:
        """Of what has passed."""
        return InputSummary(self._lines, self._moves, self._filament, self._retractions)


@dataclass(frozen=True, slots=True)
class PrintTime:
    """Duration of the print without and with the rests that compensation needs, s."""

    before: float = 0.0
    after: float = 0.0


class Clock:
    """Measures how long the print takes."""

    def __init__(self) -> None:
        self.end, self.resting = 0, 0  # samples, of all and of rests

    def samples(self, chunks: Iterable[Samples]) -> Iterator[Samples]:
        """The commands."""
        for chunk in chunks:
            self.resting += sum(e.samples for e in chunk.events if isinstance(e, Rest))
            self.end = chunk.end
            yield chunk


class FilamentMeter:
    """Measures the filament of samples and of lines passed on: ``total``, mm."""

    def __init__(self) -> None:
        self.total = 0.0

    def samples(self, chunks: Iterable[Samples]) -> Iterator[Samples]:
        """The commands."""
        for stretch in stretches(chunks):
            last: float | None = None
            for chunk in stretch:
                if len(chunk):
                    start = float(chunk.xyze[0, E]) if last is None else last
                    last = float(chunk.xyze[-1, E])
                    self.total += last - start
                for event in chunk.events:
                    if isinstance(event, Pause) and isinstance(event.action, Passthrough):
                        self.total += event.action.filament
                yield chunk


class ErrorMeter:
    """Predicts how far the nozzle is off the path: ``contour``, by strategy."""

    def __init__(self, plant: Plant) -> None:
        self._plant = plant
        self.contour: dict[str, ContourErrors] = {}

    def samples(self, chunks: Iterable[Samples]) -> Iterator[Samples]:
        """The commands."""
        for judgement in judge(chunks, self._plant, JUDGED_EVERY):
            for name, errors in judgement.contour.items():
                contour = self.contour.setdefault(name, ContourErrors())
                contour.add(errors, judgement.extruding)
            yield judgement.chunk
