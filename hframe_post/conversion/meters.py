"""Meters let a stream pass and sum it up; their summaries make the report of a conversion."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from hframe_post.arrays import TS, Array, E, Flags, lengths
from hframe_post.compensation.clamp import Clamped
from hframe_post.compensation.guard import Peaks
from hframe_post.model.plant import Plant
from hframe_post.prediction.doubts import Doubts
from hframe_post.prediction.line_width import Lines
from hframe_post.prediction.predict import judge
from hframe_post.prediction.statistics import ContourErrors, ErrorStatistics
from hframe_post.printer.settings import Limits
from hframe_post.stream.chunks import stretches
from hframe_post.stream.running import joined
from hframe_post.stream.types import Dwell, Item, MoveAtRest, Moves, Passthrough, Rest, Samples

if TYPE_CHECKING:
    from hframe_post.prediction.picture import Picture

MEASURED_TOGETHER = 4096  # moves
JUDGED_EVERY = 2  # samples; 500 Hz is far above what a printer rings at
_RETRACTION = re.compile(rb"\s*G1[01]\s*(;.*)?$", re.IGNORECASE)

# ---------------------------------------------------------------------- the file


@dataclass(slots=True)
class InputSummary:
    """What a file holds: lines, moves at known positions, filament (mm).

    firmware_retractions: G10 and G11 lines whose motion only the firmware knows.
    """

    lines: int = 0
    moves: int = 0
    filament: float = 0.0
    firmware_retractions: int = 0


class InputMeter:
    """Counts the lines of a file and what the reader made of them."""

    def __init__(self) -> None:
        self.summary = InputSummary()

    def lines(self, lines: Iterable[bytes]) -> Iterator[bytes]:
        for self.summary.lines, line in enumerate(lines, 1):
            yield line

    def items(self, items: Iterable[Item]) -> Iterator[Item]:
        summary = self.summary
        for item in items:
            if isinstance(item, Moves):
                summary.moves += len(item.line)
                summary.filament += float(item.points[-1, E] - item.points[0, E])
            elif isinstance(item, MoveAtRest):
                summary.moves += 1
                summary.filament += item.end[E] - item.start[E]
            else:
                summary.filament += item.filament
                summary.firmware_retractions += _RETRACTION.match(item.text) is not None
            yield item


@dataclass
class Uncompensated:
    """Moves that are not compensated for one reason: their number, path and filament in mm."""

    moves: int = 0
    path: float = 0.0
    filament: float = 0.0


@dataclass
class Limited:
    """Path (mm) on which one limit is lower than another, and the range of that limit."""

    path: float = 0.0
    least: float = math.inf
    greatest: float = 0.0

    def add(self, where: Flags, path: Array, limit: Array) -> None:
        """Add the moves ``where`` (n,) it applies: their path (n,) and their limit (n,)."""
        if where.any():
            self.path += float(path[where].sum())
            self.least = min(self.least, float(limit[where].min()))
            self.greatest = max(self.greatest, float(limit[where].max()))


@dataclass
class PathSummary:
    """Path and filament of all travel (mm), what is not compensated, and what limits the speed.

    acceleration (mm/s²) and corner (mm/s): limited by the file, or by the pace that was set for an
    allowed error (paced); speed (mm/s): limited by the profile.
    """

    path: float = 0.0
    filament: float = 0.0
    uncompensated: dict[str, Uncompensated] = field(default_factory=dict)
    acceleration: Limited = field(default_factory=Limited)
    corner: Limited = field(default_factory=Limited)
    speed: Limited = field(default_factory=Limited)
    paced: bool = False

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


class PathMeter:
    """Measures the path, and compares the limits of its moves with the profile's."""

    def __init__(self, limits: Limits, paced: bool = False) -> None:
        self._limits = limits
        self._summary = PathSummary(paced=paced)
        self._waiting: list[Moves] = []
        self._count = 0  # of moves that wait to be measured together

    @property
    def summary(self) -> PathSummary:
        """Return what is known of the items so far."""
        self._measure()
        return self._summary

    def items(self, items: Iterable[Item]) -> Iterator[Item]:
        for item in items:
            if isinstance(item, Moves):
                self._waiting.append(item)
                self._count += len(item.line)
                if self._count >= MEASURED_TOGETHER:
                    self._measure()
            elif isinstance(item, Passthrough) and item.cause:
                self._add_uncompensated(item)
            yield item

    def _measure(self) -> None:
        if not self._waiting:
            return
        limits, summary, waiting = self._limits, self._summary, self._waiting
        delta = np.concatenate([moves.points[1:] - moves.points[:-1] for moves in waiting])
        path = lengths(delta[:, :E])
        summary.path += float(path.sum())
        summary.filament += float(np.maximum(delta[:, E], 0.0).sum())
        share = np.abs(delta[:, :E]) / path[:, None]
        of_axes = [moves.limits.acceleration[:E] for moves in waiting]
        with np.errstate(divide="ignore"):
            counts = [len(moves.line) for moves in waiting]
            by_axis = (np.repeat(of_axes, counts, axis=0) / share).min(axis=1)
        speed, asked, corner = (
            np.concatenate([getattr(moves, name) for moves in waiting])
            for name in ("speed", "acceleration", "corner")
        )
        acceleration = np.minimum(asked, by_axis)
        summary.acceleration.add(acceleration < limits.acceleration, path, acceleration)
        summary.corner.add(corner < limits.square_corner_velocity, path, corner)
        velocity = np.full(len(path), limits.velocity)
        summary.speed.add(speed > limits.velocity, path, velocity)
        self._waiting, self._count = [], 0

    def _add_uncompensated(self, move: Passthrough) -> None:
        causes = self._summary.uncompensated
        known = move.cause in causes or len(causes) < 200  # bounds the memory of odd files
        part = causes.setdefault(move.cause if known else "others", Uncompensated())
        part.moves += 1
        part.path += move.path
        self._summary.path += move.path
        if move.path:
            part.filament += max(move.filament, 0.0)
            self._summary.filament += max(move.filament, 0.0)


# ---------------------------------------------------------------------- the commands


@dataclass(frozen=True, slots=True)
class PrintTime:
    """Duration of the print without and with the rests that compensation needs, s."""

    before: float = 0.0
    after: float = 0.0


@dataclass(slots=True)
class MotionSummary:
    """What the stages saw of one span or of several.

    samples: all; resting: those where the path rests for the command. fed: most filament in one
    stretch, mm. seconds: processor time by stage. picture: if one was asked for.
    """

    samples: int = 0
    resting: int = 0
    fed: float = 0.0
    peaks: Peaks = field(default_factory=Peaks)
    clamped: Clamped = field(default_factory=Clamped)
    contour: dict[str, ContourErrors] = field(default_factory=dict)
    width: dict[str, ErrorStatistics] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)
    picture: Picture | None = None

    @property
    def time(self) -> PrintTime:
        return PrintTime((self.samples - self.resting) * TS, self.samples * TS)

    def join(self, later: MotionSummary) -> None:
        self.samples += later.samples
        self.resting += later.resting
        self.fed = max(self.fed, later.fed)
        one, other = self.peaks, later.peaks
        (x, y), (other_x, other_y) = one.axis_acceleration, other.axis_acceleration
        self.peaks = Peaks(
            max(one.belt_velocity, other.belt_velocity),
            max(one.belt_acceleration, other.belt_acceleration),
            (max(x, other_x), max(y, other_y)),
        )
        self.clamped = self.clamped.joined(later.clamped)
        for name, errors in later.contour.items():
            self.contour.setdefault(name, ContourErrors()).join(errors)
        for name, shares in later.width.items():
            self.width.setdefault(name, ErrorStatistics()).join(shares)
        self.seconds = joined(self.seconds, later.seconds)
        if self.picture is None:
            self.picture = later.picture
        elif later.picture is not None:
            self.picture.join(later.picture)


class Clock:
    """Counts samples: all (``end``), and those in which the path rests (``resting``).

    fed: most filament in one stretch, mm.
    """

    def __init__(self) -> None:
        self.end, self.resting = 0, 0
        self.fed = 0.0
        self._begun: float | None = None  # filament at the beginning of the stretch

    def samples(self, chunks: Iterable[Samples]) -> Iterator[Samples]:
        for chunk in chunks:
            self.resting += sum(e.samples for e in chunk.events if isinstance(e, Rest))
            self.end = chunk.end
            if len(chunk):
                first, last = chunk.xyze[[0, -1], E].tolist()
                self._begun = first if self._begun is None else self._begun
                self.fed = max(self.fed, last - self._begun)
            if chunk.ends_stretch:
                self._begun = None
            yield chunk

    @property
    def time(self) -> PrintTime:
        return PrintTime((self.end - self.resting) * TS, self.end * TS)


class FilamentMeter:
    """Measures the filament of samples and pass-through lines: ``total``, mm."""

    def __init__(self) -> None:
        self.total = 0.0

    def samples(self, chunks: Iterable[Samples]) -> Iterator[Samples]:
        for stretch in stretches(chunks):
            last: float | None = None
            for chunk in stretch:
                if len(chunk):
                    start = float(chunk.xyze[0, E]) if last is None else last
                    last = float(chunk.xyze[-1, E])
                    self.total += last - start
                for event in chunk.events:
                    if isinstance(event, Dwell) and isinstance(event.action, Passthrough):
                        self.total += event.action.filament
                yield chunk


class ErrorMeter:
    """Predicts the errors of the nozzle's path and line, by strategy: ``contour`` and ``width``.

    doubts: what is not known of the plant. picture: also collects them, if given.
    """

    def __init__(
        self, plant: Plant, every: int = JUDGED_EVERY, doubts: Doubts | None = None,
        picture: Picture | None = None,
    ) -> None:  # fmt: skip
        self._plant, self._every, self._doubts = plant, every, doubts
        self.picture, self._lines = picture, Lines()
        self.contour: dict[str, ContourErrors] = {}
        self.width: dict[str, ErrorStatistics] = {}

    def samples(self, chunks: Iterable[Samples]) -> Iterator[Samples]:
        for judgement in judge(chunks, self._plant, self._every, self._doubts):
            for name, errors in judgement.contour.items():
                contour = self.contour.setdefault(name, ContourErrors())
                contour.add(errors, judgement.extruding)
                if name in judgement.products:
                    extruding = judgement.extruding[judgement.doubtful]
                    contour.doubt(judgement.products[name], extruding)
            for name, (_, shares) in self._lines.pieces(judgement).items():
                self.width.setdefault(name, ErrorStatistics()).add(shares)
            if self.picture is not None:
                self.picture.add(judgement)
            yield judgement.chunk
