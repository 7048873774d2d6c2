"""Print time against permitted error: the whole curve for a few trials of an excerpt.

Trials of the excerpt at a few accelerations and feed rates serve all bounds: for each bound, the
accelerations that use it up are interpolated, as in the search. The whole print is then planned at
these speeds, without compensation, so that its time is exact. A last trial of the excerpt gives the
errors.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
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
    freedom_of,
    gentler,
    random_plants,
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
        self._plants = self._worst((printer.plant, *random_plants(speed, printer)))

    def curve(self) -> Curve:
        own = Point(self._kept.own_seconds(), 0.0, self._errors(self._kept, None))
        today = max(self.original.errors.values(), default=0.0)
        if not (own.errors.ours and today):
            raise HframeError("this print has no features whose speed may change")
        kept = [*self._trials(self._kept, [dict.fromkeys(ADJUSTED, 1.0)])]
        raised = [*kept, *self._trials(self._raised, self._feeds())]
        worst = [_worst_error(trial) for trial in raised]
        lowest = max(*own.errors.ours.values(), min(map(_worst_error, kept)))
        bounds = np.geomspace(
            1.2 * lowest, max(min(LOOSEST * today, max(worst)), 2.0 * lowest), BOUNDS
        )
        steps = list[Step]()
        for bound in sorted({float(f"{1e3 * mm:.2g}") * 1e-3 for mm in (*bounds, today)}):
            step = Step(
                bound,
                self._point(self._kept, kept, bound),
                self._point(self._raised, raised, bound),
            )
            if steps and _same(steps[-1], step):
                continue
            steps.append(step)
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
        """Return the print that uses up a bound, mm."""
        bound = Bound(within, measure=self._measure)
        if not trials:
            raise HframeError("no acceleration that was tried can be printed")

        def distance(trial: TrialPrint) -> float:
            shares = bound.shares(trial)
            return abs(float(np.log(max(max(shares.values(), default=0.0), 1e-9))))

        trial: TrialPrint | None = None
        feeds: dict[str, float] = {}
        for _ in range(5):
            # the nearest one last, since that counts where several have the same feed rate
            ordered = sorted(trials, key=distance, reverse=True)
            searches = Searches(bound, drive.max_acceleration, ordered)
            feeds = feeds or searches.best_feeds()
            settings = searches.corrected(feeds)
            if known := next((p for s, p in self._points[drive] if s == settings), None):
                return known
            if trial is not None and settings == trial.settings:
                break
            trial = self._tried(drive, settings, self._plants)
            trials.append(trial)
            if NEAR * within <= _worst_error(trial) <= LIMIT * within:
                break
        assert trial is not None
        point = self._printed(drive, trial)
        self._points[drive].append((trial.settings, point))
        return point

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

    def _printed(self, drive: Drive, trial: TrialPrint) -> Point:
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
        return Point(seconds, _worst_error(trial), self._errors(drive, settings), whole.limited_by)

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
            for name, here in judged(judgement, layer, feature, labels):
                for strategy, contour in judgement.contour.items():
                    errors[strategy].setdefault(name, ErrorStatistics()).add(contour[here])
            for strategy, (_, shares) in lines.pieces(judgement).items():
                if strategy == self._strategy:
                    width.add(shares)


def _worst_error(trial: TrialPrint) -> float:
    return max((max(errors) for errors in trial.errors.values()), default=0.0)


def _same(one: Step, other: Step) -> bool:
    """Return whether the larger bound of the other step gains no time."""
    gains = ((p.seconds - q.seconds) / p.seconds for p, q in (
        (one.kept, other.kept), (one.raised, other.raised)
    ))  # fmt: skip
    return max(gains) < SAME
