"""What a conversion notes: a ledger of its lines, items, plans and samples, and who writes it.

``FileNotes`` and ``SampleNotes`` let a stream pass. Each span of a print has a ledger of its own;
``joined`` makes one of all. The report of a conversion reads the ledger alone.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from hframe_post.arrays import TS, E, lengths
from hframe_post.compensation.advance import AdvanceSummary
from hframe_post.compensation.clamp import Clamped
from hframe_post.compensation.guard import Peaks
from hframe_post.prediction.statistics import ContourErrors, ErrorStatistics
from hframe_post.stream.types import (
    Dwell,
    Item,
    MoveAtRest,
    Moves,
    Passthrough,
    Samples,
)
from hframe_post.writers.gcode import GcodeSummary

if TYPE_CHECKING:
    from hframe_post.prediction.picture import Picture

WIPED_MM = 8.0  # of filament at most; long tubes retract 6 mm, and less in motion
MEASURED_TOGETHER = 4096  # moves
MOST_CAUSES = 200  # bounds the memory of odd files
_RETRACTION = re.compile(rb"\s*G1[01]\s*(;.*)?$", re.IGNORECASE)


@dataclass(slots=True)
class FileTally:
    """What a file holds: lines, moves at known positions, filament (mm).

    firmware_retractions: G10 and G11 lines whose motion only the firmware knows. oddities: what is
    strange in the file, the first of each kind with its line, by kind.
    """

    lines: int = 0
    moves: int = 0
    filament: float = 0.0
    firmware_retractions: int = 0
    oddities: dict[str, str] = field(default_factory=dict)


@dataclass(slots=True)
class Uncompensated:
    """Moves that are not compensated for one reason: their number, path and filament in mm."""

    moves: int = 0
    path: float = 0.0
    filament: float = 0.0


@dataclass(slots=True)
class PathTally:
    """Path and filament of all travel (mm), and what is not compensated."""

    path: float = 0.0
    filament: float = 0.0
    uncompensated: dict[str, Uncompensated] = field(default_factory=dict)

    @property
    def path_share(self) -> float:
        """Return the share of the path that is not compensated."""
        path = sum(part.path for part in self.uncompensated.values())
        return path / self.path if self.path else 0.0

    @property
    def extrusion_share(self) -> float:
        """Return the share of the filament, laid while travelling, that is not compensated."""
        filament = sum(part.filament for part in self.uncompensated.values())
        return filament / self.filament if self.filament else 0.0


@dataclass(frozen=True, slots=True)
class StepTally:
    """What a step file holds: rows, ticks of its clock, steps by motor."""

    rows: int
    ticks: int
    clock_hz: float
    motors: dict[str, int]


@dataclass(frozen=True, slots=True, kw_only=True)
class Ledger:
    """What a conversion noted; mm and s.

    Of the file: read, path. Of its plans: slowed, the share of the path that is slower so that the
    motors can follow; following, the share of the lines that accelerate less for the extruder, and
    the least of these accelerations. As sliced: sliced_s, as the firmware plays it; elsewhere, an
    estimate for moves from unknown places, in neither time.

    Of the samples: their number; judged, those whose errors were predicted; filament_out; peaks;
    clamped; advancing, pressure advance; contour and width, errors by strategy; picture, if one was
    asked for.

    Of the output: written, steps.
    """

    read: FileTally = field(default_factory=FileTally)
    path: PathTally = field(default_factory=PathTally)
    slowed: float = 0.0
    following: tuple[float, float] | None = None
    sliced_s: float = 0.0
    elsewhere: float = 0.0
    samples: int = 0
    judged: int = 0
    filament_out: float = 0.0
    peaks: Peaks = field(default_factory=Peaks)
    clamped: Clamped = field(default_factory=Clamped)
    advancing: AdvanceSummary = field(default_factory=AdvanceSummary)
    contour: dict[str, ContourErrors] = field(default_factory=dict)
    width: dict[str, ErrorStatistics] = field(default_factory=dict)
    picture: Picture | None = field(default=None, compare=False, repr=False)
    written: GcodeSummary = field(default_factory=GcodeSummary)
    steps: StepTally | None = None

    @property
    def duration(self) -> float:
        """Return how long the motion takes, s."""
        return self.samples * TS + self.written.late


class FileNotes:
    """Notes a file: its lines and its items."""

    def __init__(self) -> None:
        self.read, self._path = FileTally(), PathTally()
        self._waiting, self._count = list[Moves](), 0  # moves that are measured together

    @property
    def path(self) -> PathTally:
        """Return what is known of the path so far."""
        self._measure()
        return self._path

    def note(self, kind: str, text: str) -> None:
        """Keep the first oddity of a kind."""
        self.read.oddities.setdefault(kind, text)

    def items(self, items: Iterable[Item]) -> Iterator[Item]:
        """Note items as they were read, and what of the path is not compensated."""
        read = self.read
        for item in items:
            if isinstance(item, Moves):
                self._waiting.append(item)
                self._count += len(item.line)
                if self._count >= MEASURED_TOGETHER:
                    self._measure()
                read.moves += len(item.line)
                read.filament += float(item.points[-1, E] - item.points[0, E])
                if "filament" not in read.oddities:
                    self._look_for_wipes(item)
            elif isinstance(item, MoveAtRest):
                read.moves += 1
                read.filament += item.end[E] - item.start[E]
            elif isinstance(item, Passthrough):
                read.lines = item.line  # the last is the end of the file
                read.filament += item.filament
                read.firmware_retractions += _RETRACTION.match(item.text) is not None
                if item.cause:
                    self._add_uncompensated(item)
            yield item

    def _look_for_wipes(self, moves: Moves) -> None:
        fed = np.diff(moves.points[:, E])
        if fed.min() < -WIPED_MM:
            k = int((fed < -WIPED_MM).argmax())
            self.note(
                "filament", f"line {moves.line[k]} takes back {-fed[k]:.1f} mm of filament while "
                "it moves, as sliced. Is a G92 E0 or M83 missing before it?"
            )  # fmt: skip

    def _measure(self) -> None:
        if not self._waiting:
            return
        path, waiting = self._path, self._waiting
        delta = np.concatenate([moves.points[1:] - moves.points[:-1] for moves in waiting])
        length = lengths(delta[:, :E])
        path.path += float(length.sum())
        path.filament += float(np.maximum(delta[:, E], 0.0).sum())
        self._waiting, self._count = [], 0

    def _add_uncompensated(self, move: Passthrough) -> None:
        causes, filament = self._path.uncompensated, max(move.filament, 0.0) if move.path else 0.0
        known = move.cause in causes or len(causes) < MOST_CAUSES
        part = causes.setdefault(move.cause if known else "others", Uncompensated())
        part.moves += 1
        part.path += move.path
        part.filament += filament
        self._path.path += move.path
        self._path.filament += filament


class SampleNotes:
    """Notes samples on their way to the output."""

    def __init__(self) -> None:
        self.end, self.filament = 0, 0.0
        self._last: float | None = None  # filament at the last sample of the stretch

    def samples(self, chunks: Iterable[Samples]) -> Iterator[Samples]:
        for chunk in chunks:
            self.end = chunk.end
            if len(chunk):
                first, last = chunk.xyze[[0, -1], E].tolist()
                self.filament += last - (first if self._last is None else self._last)
                self._last = last
            for event in chunk.events:
                if isinstance(event, Dwell) and isinstance(event.action, Passthrough):
                    self.filament += event.action.filament
            if chunk.ends_stretch:
                self._last = None
            yield chunk


def percent(share: float) -> str:
    """Return a share as text: whole from 10 % on, below with two digits."""
    value = 100.0 * share
    return f"{value:.0f} %" if value >= 10.0 else f"{value:.2g} %"
