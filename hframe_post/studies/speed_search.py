"""Search for the fastest print whose predicted error stays within a bound.

The bound holds for the model and for random printers near it. So the search

 1. prints pieces from all over the file and finds which plants have the greatest error, and at
    which of a few feed rates each kind of feature takes the least time within its bound;
 2. plans the whole print and slows layers that need time to cool;
 3. converts the whole file and judges it on those plants, with further steps until it is within
    its bounds.

The result is the last conversion, so its error is a prediction, not an extrapolation.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, cast

from hframe_post.conversion import files
from hframe_post.conversion.options import Options
from hframe_post.conversion.report import Report, Row
from hframe_post.errors import HframeError
from hframe_post.gcode.limits import slicer_settings
from hframe_post.model.plant import Plant
from hframe_post.planner.pacing import Paces
from hframe_post.printer.settings import Printer, Speed
from hframe_post.stream.running import one_blas_thread, release_memory
from hframe_post.studies.speed_drive import Convert, Drive, Original, Source
from hframe_post.studies.speed_steps import LIMIT, Bound, ExcerptSearch, Searches, gentler
from hframe_post.studies.speed_trial import Freedom, Measure, SpeedSettings, TrialPrint
from hframe_post.studies.uncertainty import draws

Attempt = Callable[[SpeedSettings], tuple[TrialPrint, Report | None]]


@dataclass(frozen=True, slots=True)
class Fastest:
    """Printer and paces that make the print fast; the conversion, as a trial and as a report."""

    printer: Printer
    paces: Paces
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
    slowest = limits.min_print_speed if said.min_speed is None else said.min_speed
    limits = replace(limits, flow=flow, min_layer_time=layer_time, min_print_speed=slowest)
    return replace(printer, limits=limits)


def freedom_of(speed: Speed, printer: Printer) -> Freedom:
    """Return what the search may change, by the profile."""
    limits = printer.limits
    return Freedom(
        speed.speed_up, limits.filament_velocity, limits.min_layer_time,
        speed.filament_acceleration or math.inf, limits.min_print_speed,
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
    least = LayerTimes.from_file(original.layers, freedom.min_layer_time)
    pieces = ExcerptSearch(drive, drive.excerpt(), (printer.plant, *near))
    settings, plants = pieces.fastest(bound)
    attempt = partial(drive.try_whole, plants=plants, convert=convert or unwritten(lines, options))
    trial, report = fastest_whole(drive, bound, settings, least, attempt)
    assert report is not None  # of a print that is not refused
    return Fastest(*drive.configured(trial.settings), bound, trial, original, report)


def unwritten(lines: Source, options: Options) -> Convert:
    """Return the conversion of a file whose output nobody needs."""
    return lambda printer, trial: files.convert(lines(), None, printer, options, trial)


def fastest_whole(
    drive: Drive, bound: Bound, settings: SpeedSettings, least: LayerTimes, attempt: Attempt
) -> tuple[TrialPrint, Report | None]:
    """Return the first attempt at the whole print within the bound, or raise HframeError."""
    searches = Searches(bound, drive.max_acceleration)
    for limit in (*[LIMIT] * 5, 1.0):
        settings = least.planned(drive, settings)
        trial, report = attempt(settings)
        shares = bound.shares(trial)
        if trial.refused:
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


# ----------------------------------------------------------------------
# Least times of layers: feed rates that leave each layer the time that it needs to cool.

FULL = 0.985  # of its least time that a layer is slowed to
USELESS = 1.001  # times its time, which a layer that was slowed does not reach
SLOWEST = 0.05  # times the feed rate; a layer that takes too little time even then stays so


@dataclass(frozen=True, slots=True)
class LayerTimes:
    """The least time of each layer by its number, s. No layer is slowed below the file's speed."""

    least: dict[int, float]

    @classmethod
    def from_file(cls, layers: dict[int, float], min_layer_time: float) -> LayerTimes:
        """Return the times of a file with these layers, s: no layer needs more than its own."""
        return cls({k: min(seconds, min_layer_time) for k, seconds in layers.items() if k})

    def short(self, settings: SpeedSettings, layers: dict[int, float]) -> bool:
        """Return whether these layers take too little time, and can be slowed."""
        present, slowed = settings.layer_feed, self.slowed(settings, layers).layer_feed
        return any(factor < present.get(layer, 1.0) for layer, factor in slowed.items())

    def slowed(self, settings: SpeedSettings, layers: dict[int, float]) -> SpeedSettings:
        """Return settings with other feed rates in layers not at 98 … 101 % of their least time.

        The exponent makes up for the part of a layer's time that does not depend on the feed rate.
        """
        factors = dict(settings.layer_feed)
        for layer, seconds in layers.items():
            share = seconds / (self.least.get(layer) or math.inf)
            factor = factors.get(layer, 1.0)
            if (0.0 < share < 0.98) or (share > 1.01 and factor < 1.0):
                factors[layer] = min(max(factor * (share / FULL) ** 1.3, SLOWEST), 1.0)
        return replace(settings, layer_feed=factors)

    def planned(self, drive: Drive, settings: SpeedSettings) -> SpeedSettings:
        """Return settings whose plan leaves each layer its time.

        The print is planned six times at most, and only once if few layers change.
        """
        layers = drive.layer_times(settings)
        for _ in range(5):
            slowed = self.slowed(settings, layers)
            if slowed == settings:
                return settings
            before, layers = layers, drive.layer_times_again(slowed, settings, layers)
            factors = {
                layer: SLOWEST
                if factor < settings.layer_feed.get(layer, 1.0)
                and layers.get(layer, 0.0) < USELESS * before.get(layer, 0.0)
                else factor
                for layer, factor in slowed.layer_feed.items()
            }  # the lowest one where a lower one slows nothing more
            settings = replace(slowed, layer_feed=factors)
        return self.slowed(settings, layers)


# ----------------------------------------------------------------------
# Report of the search for the fastest print: text and JSON.

MEASURES = {"rms": "RMS", "p95": "at 95 %", "peak": "at most"}
CAUSES = {
    "file": "features that keep the file's speed",
    "cooling": "minimum layer time",
    "travel": "travel",
    "flow": "flow of the hot end",
    "extruder": "extruder acceleration",
    "feed": "feed rate",
    "motors": "motors",
    "error": "permitted error",
}


def with_speed(found: Fastest) -> Report:
    """Return the report of the conversion that was found, with what the search found."""
    return replace(found.report, speed=speed_rows(found))


def _as_json(found: Fastest) -> dict[str, Any]:
    trial, original = found.trial, found.original
    limited_by = {cause: round(seconds, 3) for cause, seconds in trial.limited_by.items()}
    return {
        "print_time_s": {
            "before": round(original.seconds, 3), "after": round(trial.seconds, 3),
        },
        "measure": found.bound.measure,
        "width_bound_percent": _percent([found.bound.width]),
        "features": {
            name: {
                "bound_um": round(found.bound.limit(name) * 1e3, 4),
                "predicted_um": round(errors[0] * 1e3, 4),
                "under_model_error_um": round(max(errors) * 1e3, 4),
                "width_percent": _percent(trial.widths.get(name)),
                "uncompensated_um": round(original.errors.get(name, 0.0) * 1e3, 4),
                "acceleration": round(trial.settings.acceleration[name], 1),
                "feed": round(trial.settings.feed[name], 3),
            }
            for name, errors in trial.errors.items()
        },
        "limits": {
            "flow": found.printer.limits.flow,
            "min_layer_time_s": found.printer.limits.min_layer_time,
            "min_print_speed": found.printer.limits.min_print_speed,
        },
        "limited_by_s": limited_by,
    }  # fmt: skip


def speed_rows(found: Fastest) -> tuple[Row, ...]:
    """Return errors and widths by feature, the limits that hold, and what limits the speed."""
    trial, original, limits = found.trial, found.original, found.printer.limits
    measure, rows = MEASURES[found.bound.measure], list[Row]()
    for name, errors in sorted(trial.errors.items()):
        if errors[0] < 1e-5:  # straight lines at one speed, such as those that prime
            continue
        um, worse = errors[0] * 1e3, max(errors) * 1e3
        before, feed = original.errors.get(name, 0.0) * 1e3, trial.settings.feed[name]
        slower = f"; at {100.0 * feed:.0f} % of the file's feed" if feed < 1.0 else ""
        text = (
            f"{name} {um:.0f} µm {measure}, {worse:.0f} with model uncertainty; "
            f"{found.bound.limit(name) * 1e3:.0f} permitted; {before:.0f} without hframe-post"
        )
        rows.append(Row("error", text + slower))
    for name, widths in sorted(trial.widths.items()):
        text = (
            f"{name} off by {100.0 * widths[0]:.1f} % {measure}, {100.0 * max(widths):.1f} with "
            f"model uncertainty; {100.0 * found.bound.width:g} permitted"
        )
        rows.append(Row("width", text))
    total = sum(trial.limited_by.values()) or 1.0
    causes = ", ".join(
        f"{CAUSES[cause]} {100.0 * seconds / total:.0f} %"
        for cause, seconds in sorted(trial.limited_by.items(), key=lambda item: -item[1])
        if seconds > 0.01 * total
    )
    held = (
        f"flow {limits.flow:g} mm³/s, layers of at least {limits.min_layer_time:g} s at "
        f"{limits.min_print_speed:g} mm/s or more (of the profile, and of the filament as the "
        "file has it)"
    )
    known = {"speed": _as_json(found)}
    return (*rows, Row("limits", held), Row("limited by", f"{causes} of the time", known))


def _percent(shares: list[float] | None) -> float | None:
    """Return the greatest share in percent; None if nothing is measured or limited."""
    most = max(shares or [math.inf])
    return round(100.0 * most, 3) if math.isfinite(most) else None
