"""Print time against permitted error: the whole curve for a few trials of an excerpt.

Trials of the excerpt at a few accelerations and feed rates serve all bounds: for each bound, the
accelerations that use it up are interpolated, as in the search. The whole print is then planned at
these speeds, without compensation, so that its time is exact. A last trial of the excerpt gives the
errors. At the least bound and at the error that the file has today, the whole print is converted.
How much greater its errors are than those of the excerpt is interpolated for the other bounds.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import cast

import numpy as np

from hframe_post.compensation.shape import SHAPER, shape
from hframe_post.conversion.options import MAX_SPEED_UP, Options
from hframe_post.errors import HframeError
from hframe_post.firmware.registry import firmware
from hframe_post.model.plant import Plant
from hframe_post.model.shapers import Shaping
from hframe_post.prediction.line_width import Lines
from hframe_post.prediction.predict import judge
from hframe_post.prediction.statistics import ErrorStatistics, Labels
from hframe_post.printer.settings import Limits, Printer
from hframe_post.stream.running import one_blas_thread, release_memory
from hframe_post.stream.types import Samples
from hframe_post.studies.inputs import Piece
from hframe_post.studies.shapers.search import good, paths
from hframe_post.studies.speed.cooling import LayerTimes
from hframe_post.studies.speed.drive import Drive, Original, Source
from hframe_post.studies.speed.search import (
    LIMIT,
    NEAR,
    Bound,
    Searches,
    fastest_whole,
    freedom_of,
    gentler,
    random_plants,
    unwritten,
    with_slicer_limits,
)
from hframe_post.studies.speed.trial import (
    ADJUSTED,
    JUDGED_EVERY,
    Measure,
    SpeedSettings,
    TrialPrint,
    judged,
    measured,
)

LEVELS = tuple(0.3**k for k in range(4))  # of the greatest acceleration, tried at each feed rate
FEED_STEP, MOST_FEEDS = 0.6, 2  # of feed rates above the file's
BOUNDS = 5  # of the curve, in addition to today's error
LOOSEST = 2.0  # times today's error
START = 8e3  # mm/s² at which the plants with the greatest errors are found
SAME = 0.004  # share of the time; a smaller gain is not shown


Ratios = dict[str, list[float]]  # by feature and plant: errors of the whole print over an excerpt's


@dataclass(frozen=True, slots=True)
class Errors:
    """Errors of the model (mm) by feature, compensated and with the best input shaper.

    width: RMS share by which the width of the compensated line is off.
    """

    ours: dict[str, float]
    shaped: dict[str, float]
    width: float


@dataclass(frozen=True, slots=True)
class Point:
    """A print: its duration, its errors and the seconds by what limits its speed.

    worst: mm, of the worst feature on the worst plant near the model.
    """

    seconds: float
    worst: float
    errors: Errors
    limited_by: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Step:
    """The prints within a bound (mm): with the file's feed rates, and with any up to the limits."""

    bound: float
    kept: Point
    raised: Point


@dataclass(frozen=True, slots=True)
class Curve:
    """Prints from the file's own speed to what the limits allow.

    original: not compensated. shaping: of the best input shaper, if anything is printed. own: at
    the file's speed, compensated. limits: of the profile and the file.
    """

    original: Original
    measure: Measure
    shaping: Shaping | None
    own: Point
    limits: Limits
    steps: tuple[Step, ...]


@one_blas_thread()
def curve(lines: Source, printer: Printer, options: Options) -> Curve:
    """Return the curve of a file. options: resolved. Raises HframeError."""
    found = _Tracer(lines, printer, options).curve()
    release_memory()
    return found


class _Tracer:
    """What all points of the curve share."""

    def __init__(self, lines: Source, printer: Printer, options: Options) -> None:
        speed, printer = printer.known_speed, with_slicer_limits(printer, lines())
        self.limits = printer.limits
        self._measure = cast(Measure, speed.error_measure)
        self._strategy, self._plant = options.strategy, printer.plant
        freedom = freedom_of(speed, printer)
        kept = replace(freedom, speed_up=1.0)
        self._kept = Drive(lines, printer, options, self._measure, kept)
        self._raised = self._kept.freed(replace(freedom, speed_up=MAX_SPEED_UP))
        self.original = self._kept.original()
        self._least = LayerTimes({
            layer: min(seconds, freedom.min_layer_time)
            for layer, seconds in self.original.layers.items()
            if layer
        })  # fmt: skip
        self._pieces = self._kept.excerpt()
        self._shaping = good(printer.plant, paths(lines(), printer, options), firmware(printer))
        self._points: dict[Drive, list[tuple[SpeedSettings, Point]]] = {
            self._kept: [], self._raised: [],
        }  # fmt: skip
        self._convert = unwritten(lines)
        self._ratios: dict[Drive, dict[float, Ratios]] = {self._kept: {}, self._raised: {}}
        self._plants = self._worst((printer.plant, *random_plants(speed, printer)))

    def curve(self) -> Curve:
        own = Point(self._kept.own_seconds(), 0.0, self._errors(self._kept, None))
        today = max(self.original.errors.values(), default=0.0)
        if not (own.errors.ours and today):
            raise HframeError(
                "no feature of this print may change its speed: the first layer keeps its own"
            )
        kept = [*self._trials(self._kept, [dict.fromkeys(ADJUSTED, 1.0)])]
        raised = [*kept, *self._trials(self._raised, self._feeds())]
        worst = [_worst_error(trial) for trial in raised]
        lowest = max(*own.errors.ours.values(), min(map(_worst_error, kept)))
        bounds = np.geomspace(
            1.2 * lowest, max(min(LOOSEST * today, max(worst)), 2.0 * lowest), BOUNDS
        )
        levels = sorted({_rounded(mm) for mm in (*bounds, today)})
        found = dict[float, Step]()
        # what the whole print is at these two, the others need
        for level in sorted(levels, key=lambda one: one not in (levels[0], _rounded(today))):
            with suppress(HframeError):  # the whole print may have more than the excerpt
                found[level] = Step(
                    level,
                    self._point(self._kept, kept, level),
                    self._point(self._raised, raised, level),
                )
        if not found:
            raise HframeError("this print can be kept within no error that was tried")
        steps = list[Step]()
        for level in sorted(found):
            if not (steps and _same(steps[-1], found[level])):
                steps.append(found[level])
        return Curve(self.original, self._measure, self._shaping, own, self.limits, tuple(steps))

    def _worst(self, plants: tuple[Plant, ...]) -> tuple[Plant, ...]:
        """Return the model and the plants with the greatest errors. Raises HframeError."""
        settings = SpeedSettings(
            dict.fromkeys(ADJUSTED, min(START, self._kept.max_acceleration)),
            dict.fromkeys(ADJUSTED, 1.0),
        )
        trial = self._tried(self._kept, settings, plants)
        worst = (np.argsort(errors)[-2:].tolist() for errors in trial.errors.values())
        return tuple(plants[k] for k in sorted({0}.union(*worst)))

    def _feeds(self) -> list[dict[str, float]]:
        """Return factors on the feed rates by feature, from the greatest useful ones down."""
        useful = self._raised.useful_feeds(self._pieces)
        return [
            {
                name: max(min(useful.get(name, 1.0), MAX_SPEED_UP) * FEED_STEP**k, 1.0)
                for name in ADJUSTED
            }
            for k in range(MOST_FEEDS)
        ]

    def _trials(self, drive: Drive, feeds: list[dict[str, float]]) -> Iterator[TrialPrint]:
        for feed in feeds:
            for level in LEVELS:
                acceleration = dict.fromkeys(ADJUSTED, level * drive.max_acceleration)
                settings = SpeedSettings(acceleration, feed)
                trial = drive.try_pieces(self._pieces[::2], settings, self._plants)
                if not trial.refused:
                    yield trial

    def _point(self, drive: Drive, trials: list[TrialPrint], within: float) -> Point:
        """Return the print that uses up a bound, mm. The first two of a drive are converted."""
        if not trials:
            raise HframeError("no acceleration that was tried can be printed")
        bound = Bound(within, measure=self._measure)
        trial = self._used_up(drive, trials, bound, {})
        if known := next((p for s, p in self._points[drive] if s == trial.settings), None):
            return known
        if len(self._ratios[drive]) < 2:
            point = self._converted(drive, bound, trial.settings)
        else:
            ratios = _between(self._ratios[drive], within)
            if _worst_error(_scaled(trial, ratios)) > LIMIT * within:
                trial = self._used_up(drive, trials, bound, ratios)
            point = self._printed(drive, trial, ratios)
        self._points[drive].append((trial.settings, point))
        return point

    def _used_up(
        self, drive: Drive, trials: list[TrialPrint], bound: Bound, ratios: Ratios
    ) -> TrialPrint:
        """Return a trial of the excerpt that uses up a bound, and add it to the others."""

        def distance(trial: TrialPrint) -> float:
            shares = bound.shares(trial)
            return abs(float(np.log(max(max(shares.values(), default=0.0), 1e-9))))

        trial: TrialPrint | None = None
        feeds: dict[str, float] = {}
        for _ in range(5):
            # the nearest one last, since that counts where several have the same feed rate
            scaled = (_scaled(trial, ratios) for trial in trials)
            ordered = sorted(scaled, key=distance, reverse=True)
            searches = Searches(bound, drive.max_acceleration, ordered)
            feeds = feeds or searches.best_feeds()
            settings = searches.corrected(feeds)
            if trial is not None and settings == trial.settings:
                break
            trial = self._tried(drive, settings, self._plants)
            trials.append(trial)
            worst = _worst_error(_scaled(trial, ratios))
            if NEAR * bound.others <= worst <= LIMIT * bound.others:
                break
        assert trial is not None
        return trial

    def _converted(self, drive: Drive, bound: Bound, settings: SpeedSettings) -> Point:
        """Return the whole print within a bound, and note its errors over those of the excerpt."""
        whole, _ = fastest_whole(drive, bound, settings, self._plants, self._least, self._convert)
        trial = self._tried(drive, whole.settings, self._plants)
        self._ratios[drive][bound.others] = {
            name: [
                mm / max(other, 1e-9) for mm, other in zip(errors, trial.errors[name], strict=True)
            ]
            for name, errors in whole.errors.items()
            if name in trial.errors
        }
        errors = self._errors(drive, whole.settings)
        ours = {name: errors[0] for name, errors in whole.errors.items()}
        return Point(
            whole.seconds, _worst_error(whole), replace(errors, ours=ours), whole.limited_by
        )

    def _tried(
        self, drive: Drive, settings: SpeedSettings, plants: tuple[Plant, ...]
    ) -> TrialPrint:
        """Return a trial of the excerpt, gentler if need be. Raises HframeError."""
        for _ in range(6):
            trial = drive.try_pieces(self._pieces, settings, plants)
            if not trial.refused:
                return trial
            settings = gentler(settings)
        raise HframeError(trial.refused)

    def _printed(self, drive: Drive, trial: TrialPrint, ratios: Ratios) -> Point:
        """Return the whole print at the settings of a trial, its layers given time to cool."""
        settings = trial.settings
        whole = drive.timed(settings)
        for _ in range(2):
            slowed = self._least.slowed(settings, whole.layers)
            if slowed == settings:
                break
            settings = slowed
            whole = drive.timed(settings)
        seconds = whole.seconds + self._least.missing(whole.layers)
        errors = self._errors(drive, settings)
        ours = {name: mm * ratios.get(name, [1.0])[0] for name, mm in errors.ours.items()}
        worst = _worst_error(_scaled(trial, ratios))
        return Point(seconds, worst, replace(errors, ours=ours), whole.limited_by)

    def _errors(self, drive: Drive, settings: SpeedSettings | None) -> Errors:
        """Return the errors of the excerpt."""
        errors: dict[str, dict[str, ErrorStatistics]] = defaultdict(dict)
        width = ErrorStatistics()
        for piece, commands in drive.print_pieces(self._pieces, settings)[1]:
            if self._shaping is not None:
                commands = shape(commands, {SHAPER: self._shaping})
            self._judge(piece, commands, errors, width)
        found = {
            strategy: {name: measured(one, self._measure) for name, one in by_name.items()}
            for strategy, by_name in errors.items()
        }
        return Errors(found.get(self._strategy, {}), found.get(SHAPER, {}), width.rms)

    def _judge(
        self, piece: Piece, commands: Iterator[Samples],
        errors: dict[str, dict[str, ErrorStatistics]], width: ErrorStatistics,
    ) -> None:  # fmt: skip
        labels, lines = Labels(replace(piece.start.place), by_name=False), Lines()
        for judgement in judge(commands, self._plant, JUDGED_EVERY):
            layer, feature = labels.number(judgement.chunk)
            for name, here in judged(judgement.at, layer, feature, labels):
                for strategy, contour in judgement.contour.items():
                    errors[strategy].setdefault(name, ErrorStatistics()).add(contour[here])
            for strategy, (_, shares) in lines.pieces(judgement).items():
                if strategy == self._strategy:
                    width.add(shares)


def _rounded(mm: float) -> float:
    return float(f"{1e3 * mm:.2g}") * 1e-3


def _between(known: dict[float, Ratios], bound: float) -> Ratios:
    """Return the ratios at a bound by those known at two."""
    (low, first), (high, second) = sorted(known.items())
    part = min(max(math.log(bound / low) / math.log(high / low), 0.0), 1.0)
    return {
        name: [a * (b / a) ** part for a, b in zip(first[name], second[name], strict=True)]
        for name in first
        if name in second
    }


def _scaled(trial: TrialPrint, ratios: Ratios) -> TrialPrint:
    """Return a trial of the excerpt with the errors that the whole print has."""
    errors = {
        name: [mm * ratio for mm, ratio in zip(by_plant, ratios[name], strict=True)]
        if name in ratios
        else by_plant
        for name, by_plant in trial.errors.items()
    }
    return replace(trial, errors=errors)


def _worst_error(trial: TrialPrint) -> float:
    return max((max(errors) for errors in trial.errors.values()), default=0.0)


def _same(one: Step, other: Step) -> bool:
    """Return whether the larger bound of the other step gains no time."""
    gains = ((p.seconds - q.seconds) / p.seconds for p, q in (
        (one.kept, other.kept), (one.raised, other.raised)
    ))  # fmt: skip
    return max(gains) < SAME
