"""What the stages do not count themselves: each meter lets the stream pass and sums it up."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

from hframe_post.arrays import TS, E
from hframe_post.compensation.guard import Clamped, Peaks
from hframe_post.model.plant import Plant
from hframe_post.prediction.predict import judge
from hframe_post.prediction.statistics import ContourErrors
from hframe_post.stream.chunks import stretches
from hframe_post.stream.running import joined
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


@dataclass(slots=True)
class MotionSummary:
    """What the stages saw of one span or of several.

    samples: all; resting: those where the path waits for the command. seconds: processor time by
    stage.
    """

    samples: int = 0
    resting: int = 0
    peaks: Peaks = field(default_factory=Peaks)
    clamped: Clamped = field(default_factory=Clamped)
    contour: dict[str, ContourErrors] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)

    @property
    def time(self) -> PrintTime:
        """Return the print time."""
        return PrintTime((self.samples - self.resting) * TS, self.samples * TS)

    def join(self, later: MotionSummary) -> None:
        """Add what was seen of a later span."""
        self.samples += later.samples
        self.resting += later.resting
        one, other = self.peaks, later.peaks
        self.peaks = Peaks(
            max(one.belt_velocity, other.belt_velocity),
            max(one.belt_acceleration, other.belt_acceleration),
            (
                max(one.axis_acceleration[0], other.axis_acceleration[0]),
                max(one.axis_acceleration[1], other.axis_acceleration[1]),
            ),
        )
        self.clamped = self.clamped.joined(later.clamped)
        for name, errors in later.contour.items():
            self.contour.setdefault(name, ContourErrors()).join(errors)
        self.seconds = joined(self.seconds, later.seconds)
