"""Meters let a stream pass and sum it up; their summaries make the report of a conversion."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from hframe_post.arrays import TS, E, Z
from hframe_post.compensation.advance import AdvanceSummary
from hframe_post.compensation.clamp import Clamped
from hframe_post.compensation.guard import Peaks
from hframe_post.conversion.path_meter import percent
from hframe_post.firmware.dialect import object_label
from hframe_post.model.kinematics import Differences
from hframe_post.model.plant import Plant
from hframe_post.model.responses import Plants
from hframe_post.native.stop import NEAREST
from hframe_post.planner.bands import OUTER_WALL, MotorBands, TimeInBands
from hframe_post.prediction.doubts import Doubts
from hframe_post.prediction.line_width import Lines
from hframe_post.prediction.predict import Judgement, judge, judge_window
from hframe_post.prediction.statistics import ContourErrors, ErrorStatistics, Labels
from hframe_post.prediction.windows import Windows
from hframe_post.printer.settings import Printer
from hframe_post.stream.chunks import stretches
from hframe_post.stream.features import Place, kind
from hframe_post.stream.running import joined
from hframe_post.stream.types import Dwell, Item, MoveAtRest, Moves, Passthrough, Rest, Samples
from hframe_post.writers.print_time import duration, times_of

if TYPE_CHECKING:
    from hframe_post.prediction.picture import Picture

COSTS = {  # causes of a longer print, for people
    "limits": "lower limits in the profile",
    "jerk": "smoother acceleration",
    "stops": "rests at stops",
}
WORTH_SAYING = 2e-3  # of the print's time
MOST_WIPED = 8.0  # mm of filament; long tubes retract 6 mm, and less in motion
ROUNDED_S = 60.0  # by which a time left may rise: M73 has whole minutes
JUDGED_EVERY = 2  # samples; 500 Hz is far above what a printer rings at
_RETRACTION = re.compile(rb"\s*G1[01]\s*(;.*)?$", re.IGNORECASE)

# ---------------------------------------------------------------------- the file


@dataclass(slots=True)
class InputSummary:
    """What a file holds: lines, moves at known positions, filament (mm).

    firmware_retractions: G10 and G11 lines whose motion only the firmware knows. oddities: what is
    strange in the file, the first of each kind with its line, by kind.
    """

    lines: int = 0
    moves: int = 0
    filament: float = 0.0
    firmware_retractions: int = 0
    oddities: dict[str, str] = field(default_factory=dict)


class InputMeter:
    """Counts the lines of a file and what the reader made of them.

    label: see ``Dialect``.
    """

    def __init__(self, label: Callable[[bytes], bytes | None]) -> None:
        self.summary, self._label = InputSummary(), label
        # by form, EXCLUDE_OBJECT or M486: the object that is printed, and where it began
        self._open = dict[bool, tuple[bytes, int]]()
        self._times = dict[str, float]()  # s, that the file said last

    def lines(self, lines: Iterable[bytes]) -> Iterator[bytes]:
        for self.summary.lines, line in enumerate(lines, 1):
            if line[:1] != b"G":  # few are not moves
                self._look(self.summary.lines, line)
            yield line
        for counted in self._open:
            self._check_closed(counted)

    def _look(self, number: int, line: bytes) -> None:
        """Note a label that leaves an object open, and a time left that rises."""
        label = None if line.lstrip()[:1] == b";" else self._label(line)  # hosts close comments'
        if label is not None:
            counted = object_label(line) is not None
            if label and not counted:  # M486 ends the object before
                self._check_closed(False)
            self._open[counted] = (b"" if label == b"-1" else label), number
        for clock, seconds in times_of(line).items():
            before = self._times.get(clock, math.inf)
            if clock not in ("all", "gone") and seconds > before + ROUNDED_S:
                self.note(
                    "time", f"the time left rises from {duration(before)} to {duration(seconds)} "
                    f"at line {number}, as sliced. Was the file put together from several?"
                )  # fmt: skip
            if seconds:  # start code may say 0 before the slicer does
                self._times[clock] = seconds

    def _check_closed(self, counted: bool) -> None:
        name, number = self._open.get(counted, (b"", 0))
        if name:
            self.note(
                "object", f"line {number} begins an object that nothing ends, as sliced: who "
                "excludes it may lose what follows, such as the end code"
            )  # fmt: skip

    def note(self, kind: str, text: str) -> None:
        """Keep the first oddity of a kind."""
        self.summary.oddities.setdefault(kind, text)

    def items(self, items: Iterable[Item]) -> Iterator[Item]:
        summary = self.summary
        for item in items:
            if isinstance(item, Moves):
                summary.moves += len(item.line)
                summary.filament += float(item.points[-1, E] - item.points[0, E])
                if "filament" not in summary.oddities:
                    fed = np.diff(item.points[:, E])
                    if fed.min() < -MOST_WIPED:
                        k = int((fed < -MOST_WIPED).argmax())
                        self.note(
                            "filament", f"line {item.line[k]} takes back {-fed[k]:.1f} mm of "
                            "filament while it moves, as sliced. Is a G92 E0 or M83 missing "
                            "before it?"
                        )  # fmt: skip
            elif isinstance(item, MoveAtRest):
                summary.moves += 1
                summary.filament += item.end[E] - item.start[E]
            else:
                summary.filament += item.filament
                summary.firmware_retractions += _RETRACTION.match(item.text) is not None
            yield item


# ---------------------------------------------------------------------- the commands


class Meters(Protocol):
    """Makes a meter of a study for each span of a print; ``place`` is where the span begins."""

    def begun(self, place: Place) -> Meter: ...


class Meter(Protocol):
    """Measures commands. sums: what it saw, with a method that joins those of the next span."""

    sums: Any

    def samples(self, chunks: Iterable[Samples]) -> Iterator[Samples]: ...


@dataclass(frozen=True, slots=True)
class PrintTime:
    """Duration of the print, s: as the firmware plays the sliced file, and as converted.

    ramps: of the converted path if nothing limited its jerk; resting: added at stops. slowed: share
    of the path that is slower so that the motors can follow.
    """

    before: float = 0.0
    after: float = 0.0
    ramps: float = 0.0
    resting: float = 0.0
    slowed: float = 0.0

    @property
    def costs(self) -> dict[str, float]:
        """Return the seconds that the print takes longer than as sliced, by cause."""
        return {
            "limits": self.ramps - self.before,
            "jerk": self.after - self.resting - self.ramps,
            "stops": self.resting,
        }

    @property
    def _motors(self) -> str:
        return f" ([motors]: {percent(self.slowed)} of the path)" if self.slowed else ""

    def as_text(self) -> str:
        """Return both times, and what costs the difference."""
        change = 100.0 * (self.after / self.before - 1.0) if self.before else 0.0
        text = f"{duration(self.before)} → {duration(self.after)} ({change:+.1f} %)"
        causes = [
            f"{s:.0f} s for {COSTS[cause]}{self._motors if cause == 'limits' else ''}"
            for cause, s in sorted(self.costs.items(), key=lambda each: -each[1])
            if s >= max(0.5, WORTH_SAYING * self.before)
        ]
        return f"{text}: {', '.join(causes)}" if causes and change > 0.0 else text


@dataclass(slots=True)
class MotionSummary:
    """What the stages saw of one span or of several.

    fed: most filament in one stretch, mm. resting: samples added at stops. seconds: processor time
    by stage. picture: if one was asked for. advance: pressure advance. in_bands: outer walls, and
    what of them a motor spends in a band that it avoids. metered: sums of the options' meters.
    judged: samples whose errors were predicted.
    """

    samples: int = 0
    fed: float = 0.0
    resting: int = 0
    peaks: Peaks = field(default_factory=Peaks)
    clamped: Clamped = field(default_factory=Clamped)
    contour: dict[str, ContourErrors] = field(default_factory=dict)
    width: dict[str, ErrorStatistics] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)
    picture: Picture | None = None
    advance: AdvanceSummary = field(default_factory=AdvanceSummary)
    in_bands: TimeInBands = field(default_factory=TimeInBands)
    metered: Any = None
    judged: int = 0

    @property
    def duration(self) -> float:
        """Return how long the motion takes, s."""
        return self.samples * TS

    def join(self, later: MotionSummary) -> None:
        self.samples += later.samples
        self.judged += later.judged
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
        self.in_bands.total += later.in_bands.total
        self.in_bands.inside += later.in_bands.inside
        self.seconds = joined(self.seconds, later.seconds)
        self.advance.join(later.advance)
        if self.picture is None:
            self.picture = later.picture
        elif later.picture is not None:
            self.picture.join(later.picture)
        if self.metered is None:
            self.metered = later.metered
        elif later.metered is not None:
            self.metered.join(later.metered)


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


class BandMeter:
    """Measures how long motors are in the bands that they avoid, while outer walls are printed.

    strategy: whose commands count. place: where in the print the first chunk begins.
    """

    def __init__(self, printer: Printer, strategy: str, place: Place) -> None:
        self._bands, self._strategy = MotorBands.from_printer(printer), strategy
        self._kinematics = printer.kinematics
        self._labels, self.time = Labels(replace(place)), TimeInBands()

    def samples(self, chunks: Iterable[Samples]) -> Iterator[Samples]:
        if self._bands is None:
            yield from chunks
            return
        for stretch in stretches(chunks):
            rates = Differences(self._kinematics)
            for chunk in stretch:
                self._add(chunk, rates, self._bands)
                yield chunk

    def _add(self, chunk: Samples, rates: Differences, bands: MotorBands) -> None:
        _, feature = self._labels.number(chunk)
        walls = [n for n, name in enumerate(self._labels.features) if kind(name) == OUTER_WALL]
        outer = np.isin(feature, walls)
        command = chunk.commands.get(self._strategy, chunk.xyze[:, :Z])
        inside = bands.contains(rates.rates(command).belt_velocity)
        self.time.total += TS * np.count_nonzero(outer)
        self.time.inside += TS * np.count_nonzero(outer & inside)


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

    doubts: what is not known of the plant. picture: also collects them, if given. whole: samples
    from the first one on that are all judged, and a share of those after them; None: judge all.
    judged: samples that were.
    """

    def __init__(
        self, plant: Plant, every: int = JUDGED_EVERY, doubts: Doubts | None = None,
        picture: Picture | None = None, whole: int | None = None,
    ) -> None:  # fmt: skip
        self._plant, self._every, self._doubts = plant, every, doubts
        self._whole, self.judged = whole, 0
        self.picture, self._lines = picture, Lines()
        self.contour: dict[str, ContourErrors] = {}
        self.width: dict[str, ErrorStatistics] = {}

    def samples(self, chunks: Iterable[Samples]) -> Iterator[Samples]:
        if self._whole is None:
            for judgement in judge(chunks, self._plant, self._every, self._doubts):
                self._add(judgement, self._lines)
                if self.picture is not None:
                    self.picture.add(judgement)
                yield judgement.chunk
            return
        doubts, plants = self._doubts, Plants([self._plant])
        before = max(self._plant.memory, doubts.past if doubts is not None else 0, NEAREST)
        after = self._plant.ahead + NEAREST + 1 + (doubts.ahead if doubts is not None else 0)
        for chunk, windows in Windows(before, after, self._whole).samples(chunks):
            for each in windows:
                judgement = judge_window(each, plants, self._every, doubts)
                self._add(judgement, Lines(), each.weight)
            yield chunk

    def _add(self, judgement: Judgement, lines: Lines, weight: int = 1) -> None:
        self.judged += len(judgement.chunk)
        for name, errors in judgement.contour.items():
            contour = self.contour.setdefault(name, ContourErrors())
            contour.add(errors, judgement.extruding, weight)
            if name in judgement.products:
                extruding = judgement.extruding[judgement.doubtful]
                contour.doubt(judgement.products[name], extruding, weight)
        for name, (_, shares) in lines.pieces(judgement).items():
            self.width.setdefault(name, ErrorStatistics()).add(shares, weight)
