"""What a conversion notes: a ledger of its lines, items, plans and samples, and its warnings.

``FileTally`` and ``SampleNotes`` let a stream pass. Each span of a print has a ledger of its own;
``joined`` makes one of all. The report of a conversion reads the ledger alone.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING

import numpy as np

from hframe_post.arrays import TS, E, lengths
from hframe_post.compensation.advance import AdvanceSummary
from hframe_post.compensation.clamp import Clamped
from hframe_post.compensation.guard import Peaks
from hframe_post.gcode.reader import CHANGE_OF_OBJECT, START_OF_FILE
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
TOOL = re.compile(r"T[1-9]\d*")
SLIGHT = 0.005  # share of extrusion or time that no owner notices
REMEDIES = {  # of extrusion that is not compensated, by causes other than commands
    START_OF_FILE: "because its place is not known: begin with a move to X, Y and Z",
    CHANGE_OF_OBJECT: "because an object begins without a travel to it",
}
_RETRACTION = re.compile(rb"\s*G1[01]\s*(;.*)?$", re.IGNORECASE)


@dataclass(slots=True)
class Uncompensated:
    """Moves that are not compensated for one reason: their number, path and filament in mm."""

    moves: int = 0
    path: float = 0.0
    filament: float = 0.0


@dataclass(slots=True)
class FileTally:
    """What a file holds, noted while its items pass: lines, moves at known positions, filament.

    firmware_retractions: G10 and G11 lines whose motion only the firmware knows. path: of all
    travel; laid: filament meanwhile, both in mm; uncompensated: what of both is not compensated, by
    cause. oddities: what is strange in the file, the first of each kind with its line, by kind.
    """

    lines: int = 0
    moves: int = 0
    filament: float = 0.0
    firmware_retractions: int = 0
    path: float = 0.0
    laid: float = 0.0
    uncompensated: dict[str, Uncompensated] = field(default_factory=dict)
    oddities: dict[str, str] = field(default_factory=dict)

    @property
    def path_share(self) -> float:
        """Return the share of the path that is not compensated."""
        path = sum(part.path for part in self.uncompensated.values())
        return path / self.path if self.path else 0.0

    @property
    def extrusion_share(self) -> float:
        """Return the share of the filament, laid while travelling, that is not compensated."""
        filament = sum(part.filament for part in self.uncompensated.values())
        return filament / self.laid if self.laid else 0.0

    def note(self, kind: str, text: str) -> None:
        """Keep the first oddity of a kind."""
        self.oddities.setdefault(kind, text)

    def items(self, items: Iterable[Item]) -> Iterator[Item]:
        """Note items as they were read."""
        for item in items:
            if isinstance(item, Moves):
                self._measure(item)
            elif isinstance(item, MoveAtRest):
                self.moves += 1
                self.filament += item.end[E] - item.start[E]
            elif isinstance(item, Passthrough):
                self.lines = item.line  # the last is the end of the file
                self.filament += item.filament
                self.firmware_retractions += _RETRACTION.match(item.text) is not None
                if item.cause:
                    self._add_uncompensated(item)
            yield item

    def _measure(self, moves: Moves) -> None:
        delta = moves.points[1:] - moves.points[:-1]
        fed = delta[:, E]
        self.moves += len(moves.line)
        self.filament += float(moves.points[-1, E] - moves.points[0, E])
        self.path += float(lengths(delta[:, :E]).sum())
        self.laid += float(np.maximum(fed, 0.0).sum())
        if fed.min() < -WIPED_MM:
            k = int((fed < -WIPED_MM).argmax())
            self.note(
                "filament", f"line {moves.line[k]} takes back {-fed[k]:.1f} mm of filament while "
                "it moves, as sliced. Is a G92 E0 or M83 missing before it?"
            )  # fmt: skip

    def _add_uncompensated(self, move: Passthrough) -> None:
        causes, filament = self.uncompensated, max(move.filament, 0.0) if move.path else 0.0
        known = move.cause in causes or len(causes) < 200  # bounds the memory of odd files
        part = causes.setdefault(move.cause if known else "others", Uncompensated())
        part.moves += 1
        part.path += move.path
        part.filament += filament
        self.path += move.path
        self.laid += filament


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

    Of the file: read. Of its plans: slowed, the share of the path that is slower so that the
    motors can follow; following, the share of the lines that accelerate less for the extruder, and
    the least of these accelerations. As sliced: sliced_s, as the firmware plays it; elsewhere, an
    estimate for moves from unknown places, in neither time.

    Of the samples: their number; judged, those whose errors were predicted; filament_out; peaks;
    clamped; advancing, pressure advance; contour and width, errors by strategy; picture, if one was
    asked for.

    Of the output: written, steps.
    """

    read: FileTally = field(default_factory=FileTally)
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


# ---------------------------------------------------------------------- what must not be overlooked


def warnings(
    ledger: Ledger, other_tools: tuple[str, ...] | None, lines_per_second: float
) -> Iterator[str]:
    """Yield a sentence for each.

    other_tools: commands after which the plant is not that of the tool that prints; None if the
    profile does not say. lines_per_second: that the firmware takes.
    """
    if not ledger.read.moves:
        yield (
            "nothing was compensated, because no move starts at a known position: move to an "
            "absolute X, Y and Z before printing"
        )
    yield from ledger.read.oddities.values()
    yield from _uncompensated(ledger, other_tools)
    if (busiest := ledger.written.busiest_second) > lines_per_second:
        yield (
            f"up to {busiest} lines in a second; the printer takes {lines_per_second:.0f} "
            "(lines_per_second in the profile), so it may stutter"
        )
    if (count := ledger.read.firmware_retractions) > 9:  # fewer are those of macros
        yield (
            f"estimated duration of {count} G10/G11: less is compensated next to them. Say in "
            "[retraction] of the profile what they do"
        )
    if (clamped := ledger.clamped).samples:
        share = 1e-3 * clamped.samples / (ledger.duration + ledger.elsewhere)
        yield (
            f"less is compensated on {percent(share)} of the print, first at line {clamped.line}, "
            f"by up to {clamped.most:.3f} mm: the bed's edge ([travel] of the profile) or the "
            "motors ([motors]) allow no more. If the motors can do more, raise "
            "motors.belt_acceleration"
        )


def _uncompensated(ledger: Ledger, other_tools: tuple[str, ...] | None) -> Iterator[str]:
    """Yield what to do about tools without a model, and about the main cause of the rest."""
    read, parts = ledger.read, ledger.read.uncompensated
    others = {
        cause: part.filament
        for cause, part in parts.items()
        if any(fnmatchcase(cause, name.upper()) for name in other_tools or ())
    }
    if other_tools is None and (tools := ", ".join(filter(TOOL.fullmatch, parts))):
        yield (
            f"the file changes tools ({tools}), and all are compensated with the model of one. "
            "If they are separate heads, list those that were not measured below [firmware] of "
            'the profile, such as other_tools = ["T1"]; otherwise write other_tools = []'
        )
    if filament := sum(others.values()):
        yield (
            f"{percent(filament / read.laid)} of the extrusion is not compensated: the "
            f"profile has no model of {', '.join(others)} (other_tools in the profile)"
        )
    cause = max(parts, key=lambda name: parts[name].filament, default="")
    if read.extrusion_share > SLIGHT and cause not in others:
        yield (
            f"{100.0 * read.extrusion_share:.1f} % of the extrusion is not compensated, "
        ) + REMEDIES.get(
            cause,
            f"mostly after {cause}. If {cause} does not move the head, add it to harmless in "
            "[firmware] of the profile; if the head comes back, add it to returns",
        )
