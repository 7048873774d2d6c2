"""Search for the fastest print whose predicted error stays within a bound.

The error grows with the acceleration of the path, and it is local: each kind of feature has its own
search for the acceleration at which it uses up its bound, and each trial print is a step of them
all. The bound holds for the model and for random printers near it. So the search

 1. prints pieces from all over the file and finds which plants have the greatest error, and at
    which of a few feed rates each kind of feature takes the least time within its bound;
 2. plans the whole print and slows layers that need time to cool;
 3. converts the whole file and judges it on those plants, with further steps until it is within
    its bounds.

The result is the last conversion, so its error is a prediction, not an extrapolation.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import cast

import numpy as np

from hframe_post.conversion import files
from hframe_post.conversion.options import Options
from hframe_post.conversion.report import Report
from hframe_post.errors import HframeError
from hframe_post.gcode.slicer_settings import slicer_settings
from hframe_post.model.plant import Plant
from hframe_post.planner.pacing import NAMES
from hframe_post.printer.settings import Printer, Speed
from hframe_post.stream.running import one_blas_thread, release_memory
from hframe_post.studies.simulation.uncertainty import draws
from hframe_post.studies.speed.cooling import LayerTimes
from hframe_post.studies.speed.drive import Convert, Drive, Original, Source
from hframe_post.studies.speed.trial import (
    ADJUSTED,
    CAUSES,
    Freedom,
    Measure,
    SpeedSettings,
    TrialPrint,
)

NEAR, LIMIT = 0.87, 0.95  # share of a bound to use up: other printers may have a greater error
AIM = math.sqrt(NEAR * LIMIT)
FEED_STEP = 0.8  # factor from one feed rate that is tried to the next
MIN_FEED, MAX_FEEDS = 0.3, 8  # times the file's feed rates; how many are tried
MIN_ACCELERATION = 200.0  # mm/s²


@dataclass(frozen=True, slots=True)
class Bound:
    """Greatest errors (mm): by kind of feature, and of all others. width: of lines, as a share."""

    others: float
    kinds: dict[str, float] = field(default_factory=dict)
    measure: Measure = "p95"
    width: float = math.inf

    def limit(self, name: str) -> float:
        return self.kinds.get(name, self.others)

    def shares(self, trial: TrialPrint) -> dict[str, float]:
        """Return the share of its bound that each feature uses up on its worst plant."""
        shares = {name: max(errors) / self.limit(name) for name, errors in trial.errors.items()}
        for name, widths in trial.widths.items():
            shares[name] = max(shares[name], max(widths) / self.width)
        return shares


@dataclass(frozen=True, slots=True)
class Fastest:
    """Printer and options that make the print fast; the conversion, as a trial and as a report."""

    printer: Printer
    options: Options
    bound: Bound
    trial: TrialPrint
    original: Original
    report: Report


def find_fastest(lines: Source, printer: Printer, options: Options, convert: Convert) -> Fastest:
    """Return the fastest print within the error that ``options.speed`` allows.

    convert: writes the print; what it wrote last is the print that is found. Raises HframeError if
    no print is within the error.
    """
    speed, printer = options.speed, with_slicer_limits(printer, lines())
    assert speed is not None
    errors = speed.max_error
    bound = Bound(
        errors.get("", max(errors.values())),
        {name: error for name, error in errors.items() if name},
        cast(Measure, speed.error_measure), speed.max_width_error or math.inf,
    )  # fmt: skip
    freedom, near = freedom_of(speed, printer), random_plants(speed, printer)
    found = search(lines, printer, options, bound, freedom, near, convert)
    release_memory()
    return found


def with_slicer_limits(printer: Printer, lines: Iterable[bytes]) -> Printer:
    """Return the printer with what the slicer knows of the filament in this file.

    The hot end melts no more than the profile says; a layer takes as long as the slicer says.
    """
    said, limits = slicer_settings(lines), printer.limits
    flow = min(limits.flow, max(said.flow or math.inf, 0.1))
    layer_time = limits.min_layer_time if said.layer_time is None else min(said.layer_time, 600.0)
    return replace(printer, limits=replace(limits, flow=flow, min_layer_time=layer_time))


def freedom_of(speed: Speed, printer: Printer) -> Freedom:
    """Return what the search may change, by the profile."""
    limits = printer.limits
    return Freedom(
        speed.speed_up, limits.filament_velocity, limits.min_layer_time,
        speed.filament_acceleration or math.inf,
    )  # fmt: skip


def random_plants(speed: Speed, printer: Printer) -> tuple[Plant, ...]:
    """Return the plants in addition to the printer's on which bounds must hold."""
    return tuple(draws(printer.plant, speed.model_error, 40 if speed.model_error else 0, seed=0))


@one_blas_thread()
def search(
    lines: Source, printer: Printer, options: Options, bound: Bound,
    freedom: Freedom | None = None, near: tuple[Plant, ...] = (), convert: Convert | None = None,
) -> Fastest:  # fmt: skip
    """Return the fastest print within the bound, or raise HframeError.

    freedom: by default, feed rates are not raised. near: plants in addition to the printer's on
    which the bound must hold. convert: see ``find_fastest``; by default nothing is written.
    """
    freedom = freedom or Freedom()
    drive = Drive(lines, printer, options, bound.measure, freedom, bound.width < math.inf)
    original = drive.original()
    least = LayerTimes(
        {k: min(seconds, freedom.min_layer_time) for k, seconds in original.layers.items() if k}
    )
    settings, plants = _fastest_pieces(drive, bound, (printer.plant, *near), freedom.speed_up)
    convert = convert or unwritten(lines)
    trial, report = fastest_whole(drive, bound, settings, plants, least, convert)
    return Fastest(*drive.configured(trial.settings), bound, trial, original, report)


def unwritten(lines: Source) -> Convert:
    """Return the conversion of a file whose output nobody needs."""

    def convert(printer: Printer, options: Options) -> Report:
        return files.convert(lines(), None, printer, options)

    return convert


def fastest_whole(
    drive: Drive, bound: Bound, settings: SpeedSettings, plants: tuple[Plant, ...],
    least: LayerTimes, convert: Convert,
) -> tuple[TrialPrint, Report]:  # fmt: skip
    """Return the first conversion of the file within the bound, or raise HframeError."""
    searches = Searches(bound, drive.max_acceleration)
    for limit in (*[LIMIT] * 5, 1.0):
        settings = least.planned(drive, settings)
        trial, report = drive.try_whole(settings, plants, convert)
        shares = bound.shares(trial)
        if report is None:
            settings = gentler(settings)
            continue
        short = least.short(settings, trial.layers)
        if max(shares.values(), default=0.0) <= limit and not short:
            return trial, report
        searches.trials.append(trial)
        settings = least.slowed(searches.corrected(settings.feed), trial.layers)
    if trial.refused:
        raise HframeError(trial.refused)
    worst = max(shares, key=lambda name: shares[name])
    raise HframeError(
        f"this print cannot be kept within that error: even at the lowest speed tried, {worst} has "
        f"{_exceeded(bound, trial, worst)}"
    )


def _exceeded(bound: Bound, trial: TrialPrint, name: str) -> str:
    """Return the error of a feature that exceeds its bound the most, and what to do."""
    error, width = max(trial.errors[name]), max(trial.widths.get(name, [0.0]))
    key, value = "max_error", f"an error of {error * 1e3:.0f} µm"
    if width / bound.width > error / bound.limit(name):
        key, value = (
            "max_width_error",
            f"lines that are off by {100.0 * width:.0f} % of their width",
        )
    return (
        f"{value}, model uncertainty included; allow more in {key} below [speed], or with "
        f"'hframe-post convert --{key.replace('_', '-')}'"
    )


def _fastest_pieces(
    drive: Drive, bound: Bound, near: tuple[Plant, ...], speed_up: float
) -> tuple[SpeedSettings, tuple[Plant, ...]]:
    """Return settings to begin with, and the plants with the greatest errors."""
    pieces, searches = drive.excerpt(), Searches(bound, drive.max_acceleration)
    useful = drive.useful_feeds(pieces)
    feed = {name: max(min(speed_up, useful.get(name, speed_up)), 1.0) for name in ADJUSTED}

    def worst_plants(settings: SpeedSettings, plants: tuple[Plant, ...]) -> tuple[Plant, ...]:
        """Add a trial, with gentler settings if these are refused; return its worst plants."""
        for _ in range(6):
            trial = drive.try_pieces(pieces, settings, plants)
            if not trial.refused:
                searches.trials.append(trial)
                worst = (np.argsort(errors)[-2:].tolist() for errors in trial.errors.values())
                return tuple(plants[k] for k in sorted({0}.union(*worst)))
            settings = gentler(settings)
        raise HframeError(trial.refused)

    acceleration = dict.fromkeys(ADJUSTED, min(8e3, drive.max_acceleration))
    plants = worst_plants(SpeedSettings(acceleration, feed), near)
    for _ in range(MAX_FEEDS):
        worst_plants(searches.corrected(feed), plants)
        before, feed = feed, searches.next_feeds()
        if feed == before:
            break
    feed = searches.best_feeds()
    plants = worst_plants(searches.corrected(feed), near)
    return searches.corrected(feed), plants


class Searches:
    """The searches of all kinds of features. trials: their steps so far."""

    def __init__(
        self, bound: Bound, max_acceleration: float, trials: Iterable[TrialPrint] = ()
    ) -> None:
        self._bound, self._max_acceleration = bound, max_acceleration
        self.trials = list(trials)

    def corrected(self, feed: dict[str, float]) -> SpeedSettings:
        """Return the last settings with accelerations at which features use up their bounds.

        Features of unknown error get the least acceleration of the others.
        """
        last, known = self.trials[-1], dict[str, float]()
        for name in last.errors:
            same_feed = [t for t in self.trials if t.settings.feed[name] == feed[name]]
            points = [self._point(t, name) for t in same_feed or [last] if name in t.errors]
            found = math.exp(_root(points or [self._point(last, name)]))
            known[name] = min(max(found, MIN_ACCELERATION), self._max_acceleration)
        least = min(known.values(), default=8e3)
        acceleration = {name: known.get(name, least) for name in feed}
        return replace(last.settings, acceleration=acceleration, feed=feed)

    def _point(self, trial: TrialPrint, name: str) -> tuple[float, float]:
        """Return the logarithms of acceleration and of error; the latter is 0 at the aim."""
        share = self._bound.shares(trial)[name]
        return math.log(trial.settings.acceleration[name]), math.log(max(share, 1e-9) / AIM)

    def best_feeds(self) -> dict[str, float]:
        """Return the feed rate at which each feature takes the least time within its bound."""
        return {name: min(times, key=lambda f: times[f]) for name, times in self._times().items()}

    def next_feeds(self) -> dict[str, float]:
        """Return each feature's best feed rate, or a lower one if not two lower ones were tried.

        Where a plant is slightly off the model, the path is missed at speed, and a slower feature
        may accelerate more.
        """
        feeds = self.best_feeds()
        for name, times in self._times().items():
            if min(times) > FEED_STEP**1.5 * feeds[name]:
                feeds[name] = max(FEED_STEP * min(times), MIN_FEED)
        return feeds

    def _times(self) -> dict[str, dict[float, float]]:
        """Estimate the seconds of each feature at each feed rate tried, with its bound used up.

        The time of speed changes falls with the root of the acceleration, which the motors limit.
        A feature whose error is too great must be slower as a whole.
        """
        changing = [CAUSES.index(cause) for cause in ("motors", "error")]
        times: dict[str, dict[float, float]] = {name: {} for name in ADJUSTED}
        for trial in self.trials:
            shares, used = self._bound.shares(trial), trial.settings.acceleration
            for name, feed in trial.settings.feed.items():
                seconds = trial.limited[NAMES.index(name)]
                share = shares.get(name, AIM) / AIM
                gain = math.log(min(max(share, used[name] / self._max_acceleration), 1.0))
                times[name][feed] = float(
                    seconds.sum() * max(share, 1.0) + 0.5 * gain * seconds[changing].sum()
                )
        return times


def _root(points: list[tuple[float, float]]) -> float:
    """Return where y, which rises with x, is 0 by these points; y = x + c for one.

    A point that is near enough is returned itself. Between points on both sides it is on the line
    through the nearest two. Beyond points on one side it lies beyond them all, so that each step
    leads on even where y hardly rises. Of two points with the same x the later one counts: y also
    depends on what else changed.
    """
    points = list(dict(points).items())
    nearest = min(points, key=lambda point: abs(point[1]))
    if math.log(NEAR / AIM) <= nearest[1] <= math.log(LIMIT / AIM):
        return nearest[0]
    above = sorted((point for point in points if point[1] > 0.0), key=lambda point: point[0])
    below = sorted((point for point in points if point[1] <= 0.0), key=lambda point: -point[0])
    if above and below and below[0][0] < above[0][0]:
        (u, v), (x, y) = below[0], above[0]
        return x - (x - u) * y / (y - v)
    (x, y), *others = above or below  # if neither is true of all, the limit counts
    slopes = [(y - v) / (x - u) for u, v in others if abs(x - u) > 0.01]
    slope = min(max(slopes[0], 0.4), 1.5) if slopes else 1.0
    return x - min(max(y / slope, -1.2), 1.2)


def gentler(settings: SpeedSettings) -> SpeedSettings:
    """Return settings with accelerations that are lower by 15 %."""
    acceleration = {name: 0.85 * value for name, value in settings.acceleration.items()}
    return replace(settings, acceleration=acceleration)
