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
from typing import cast

from hframe_post.conversion import files
from hframe_post.conversion.options import Options
from hframe_post.conversion.report import Report
from hframe_post.errors import HframeError
from hframe_post.gcode.limits import slicer_settings
from hframe_post.model.plant import Plant
from hframe_post.printer.settings import Printer, Speed
from hframe_post.stream.running import one_blas_thread, release_memory
from hframe_post.studies.simulation.uncertainty import draws
from hframe_post.studies.speed.cooling import LayerTimes
from hframe_post.studies.speed.drive import Convert, Drive, Original, Source
from hframe_post.studies.speed.excerpt import ExcerptSearch
from hframe_post.studies.speed.steps import LIMIT, Bound, Searches, gentler
from hframe_post.studies.speed.trial import Freedom, Measure, SpeedSettings, TrialPrint

Attempt = Callable[[SpeedSettings], tuple[TrialPrint, Report | None]]


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
    attempt = partial(drive.try_whole, plants=plants, convert=convert or unwritten(lines))
    trial, report = fastest_whole(drive, bound, settings, least, attempt)
    assert report is not None  # of a print that is not refused
    return Fastest(*drive.configured(trial.settings), bound, trial, original, report)


def unwritten(lines: Source) -> Convert:
    """Return the conversion of a file whose output nobody needs."""

    def convert(printer: Printer, options: Options) -> Report:
        return files.convert(lines(), None, printer, options)

    return convert


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
