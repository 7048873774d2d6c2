"""Print time against permitted error: the whole curve for a few conversions.

Each point is the print that a conversion with that bound begins with. At the least bound and at the
error that the file has today, it is converted; ``prints`` estimates the others.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np

from hframe_post.conversion.options import MAX_SPEED_UP, Options
from hframe_post.conversion.pipeline import Chain
from hframe_post.conversion.sliced_errors import SlicedFile
from hframe_post.errors import HframeError
from hframe_post.model.shapers import Shaping
from hframe_post.printer.settings import Limits, Printer
from hframe_post.stream.running import one_blas_thread, release_memory
from hframe_post.studies.speed_drive import Drive, Original, Source
from hframe_post.studies.speed_prints import ExcerptErrors, Point, Prints
from hframe_post.studies.speed_search import (
    CAUSES,
    MEASURES,
    LayerTimes,
    freedom_of,
    random_plants,
    unwritten,
    with_slicer_limits,
)
from hframe_post.studies.speed_steps import Bound, ExcerptSearch
from hframe_post.studies.speed_trial import Measure
from hframe_post.writers.print_time import duration

BOUNDS = 5  # of the curve, in addition to today's error
LOOSEST = 2.0  # times today's error
GENTLE = 1e3  # mm/s² whose error is about the least bound
Progress = Callable[[float], object]
SAME = 0.004  # share of the time; a smaller gain is not shown


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
    the file's speed, compensated. limits: of the profile and the file. width: largest error of the
    lines' width, as a share.
    """

    original: Original
    measure: Measure
    shaping: Shaping | None
    own: Point
    limits: Limits
    width: float
    steps: tuple[Step, ...]


@one_blas_thread()
def curve(
    lines: Source, printer: Printer, options: Options, progress: Progress | None = None
) -> Curve:
    """Return the curve of a file. options: resolved. Raises HframeError.

    progress: called with the share of the work that was done since the last call.
    """
    found = _traced(lines, printer, options, progress or (lambda share: None))
    release_memory()
    return found


def _traced(lines: Source, printer: Printer, options: Options, progress: Progress) -> Curve:
    speed, printer = printer.known_speed, with_slicer_limits(printer, lines())
    measure, width = cast(Measure, speed.error_measure), speed.max_width_error or math.inf
    freedom = freedom_of(speed, printer)
    kept = Drive(lines, printer, options, measure, replace(freedom, speed_up=1.0), width < math.inf)
    original, pieces = kept.original(), kept.excerpt()
    sliced = SlicedFile.from_items(Chain(printer, options).parsed(lines()), printer)
    shaping = sliced.shaping(printer.plant)
    errors = ExcerptErrors(pieces, printer.plant, options.strategy, shaping, measure)
    own = Point(kept.own_seconds(), 0.0, errors.at(kept, None))
    today = max(original.errors.values(), default=0.0)
    if not (own.errors.ours and today):
        raise HframeError(
            "no feature of this print may change its speed: the first layer keeps its own"
        )
    near = printer.plant, *random_plants(speed, printer)
    least = LayerTimes.from_file(original.layers, freedom.min_layer_time)
    drives = kept, kept.freed(replace(freedom, speed_up=MAX_SPEED_UP))
    searches = [ExcerptSearch(drive, pieces, near) for drive in drives]
    prints = [
        Prints(drive, search, least, errors, unwritten(lines))
        for drive, search in zip(drives, searches, strict=True)
    ]
    levels = _levels(own, today, *searches)
    found = dict[float, Step]()
    # the least and today's first: what is converted there tells the others
    for level in sorted(levels, key=lambda one: one not in (levels[0], _rounded(today))):
        progress(1.0 / (1 + len(levels)))
        bound = Bound(level, measure=measure, width=width)
        with suppress(HframeError):  # the whole print may have more than the excerpt
            found[level] = Step(level, *(each.within(bound) for each in prints))
    if not found:
        raise HframeError("this print can be kept within no error that was tried")
    return Curve(original, measure, shaping, own, printer.limits, width, tuple(_distinct(found)))


def _levels(own: Point, today: float, kept: ExcerptSearch, raised: ExcerptSearch) -> list[float]:
    """Return bounds (mm) from little above the least error to today's and beyond."""
    lowest = max(*own.errors.ours.values(), kept.error_at(GENTLE))
    highest = max(min(LOOSEST * today, raised.error_at(math.inf)), 2.0 * lowest)
    return sorted({_rounded(mm) for mm in (*np.geomspace(1.2 * lowest, highest, BOUNDS), today)})


def _rounded(mm: float) -> float:
    return float(f"{1e3 * mm:.2g}") * 1e-3


def _distinct(found: dict[float, Step]) -> Iterator[Step]:
    """Yield the steps that gain time over the one before."""
    last: Step | None = None
    for _, step in sorted(found.items()):
        if last is None or not _same(last, step):
            yield step
            last = step


def _same(one: Step, other: Step) -> bool:
    """Return whether the larger bound of the other step gains no time."""
    gains = ((p.seconds - q.seconds) / p.seconds for p, q in (
        (one.kept, other.kept), (one.raised, other.raised)
    ))  # fmt: skip
    return max(gains) < SAME


# ----------------------------------------------------------------------
# Report of print time against permitted error: text, JSON and the charts of a page.

WALL = "outer-wall"
NAMED = 0.15  # share of the time from which a cause is named
ADVICE = {
    "feed": "The file's feed rates bind: 'hframe-post convert --speed-up max' raises them",
    "cooling": "The layer time binds ({layer:g} s, limits.min_layer_time): print several parts at "
    "once, or lower it if the part cools faster",
    "flow": "The hot end binds ({flow:g} mm³/s, limits.flow)",
    "motors": "The motors bind (motors.belt_acceleration)",
    "file": "First layers, bridges and skirts keep the file's speed",
    "extruder": "The extruder binds (speed.filament_acceleration)",
}


def curve_as_json(found: Curve) -> dict[str, Any]:
    """Return all figures, ready for ``json.dumps``."""
    shaping = found.shaping
    return {
        "measure": found.measure,
        "width_bound_percent": None if math.isinf(found.width) else 100.0 * found.width,
        "as_sliced": {
            "print_time_s": round(found.original.seconds, 3),
            "error_um": _micrometres(found.original.errors),
        },
        "shaper": None if shaping is None else {"x": shaping.x.name, "y": shaping.y.name},
        "file_speed": _point_as_json(found.own),
        "points": [
            {
                "max_error_um": round(1e3 * step.bound, 3),
                "file_feed_rates": _point_as_json(step.kept),
                "speed_up_max": _point_as_json(step.raised),
            }
            for step in found.steps
        ],
    }


def _point_as_json(point: Point) -> dict[str, Any]:
    return {
        "print_time_s": round(point.seconds, 3),
        "error_um": _micrometres(point.errors.ours),
        "shaper_error_um": _micrometres(point.errors.shaped),
        "line_width_percent": round(100.0 * point.errors.width, 3),
        "limited_by_s": {cause: round(s, 3) for cause, s in point.limited_by.items()},
    }


def _micrometres(errors: dict[str, float]) -> dict[str, float]:
    return {name: round(1e3 * error, 3) for name, error in sorted(errors.items())}


# ---------------------------------------------------------------------- text


def shown_feature(found: Curve) -> str:
    """Return the feature whose error is shown: outer walls, or else the one of largest error."""
    errors = found.original.errors
    return WALL if WALL in errors else max(errors, key=lambda name: errors[name])


def curve_as_text(found: Curve) -> str:
    """Return the table, and what to do about that which binds."""
    name, before = shown_feature(found), found.original
    shaper = f"best shaper ({found.shaping.x.name})" if found.shaping else "best shaper"
    heads = ("permitted", "print time", name, shaper, "faster feed rates")
    rows = [
        ["as sliced", duration(before.seconds), _um(before.errors, name), "", ""],
        ["compensated", duration(found.own.seconds), *_errors(found.own, name), ""],
        *(
            [
                f"{1e3 * step.bound:.3g}um", _time(step.kept, before.seconds),
                *_errors(step.kept, name), _time(step.raised, before.seconds),
            ]
            for step in found.steps
        ),
    ]  # fmt: skip
    widths = [max(map(len, column)) for column in zip(heads, *rows, strict=True)]
    lines = [
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in (heads, *rows)
    ]
    held = (
        f"Errors are predicted, {MEASURES[found.measure]}; 'hframe-post convert --max-error' keeps "
        "the bound in each feature."
    )
    return "\n".join([*lines, "", held, *advice(found)])


def advice(found: Curve) -> list[str]:
    """Return what binds at the fastest prints, and the command for a print as exact as today."""
    limits, last = found.limits, found.steps[-1]
    lines = list[str]()
    for point, done in ((last.kept, ()), (last.raised, ("feed",))):
        causes = [cause for cause in _binding(point) if cause in ADVICE and cause not in done]
        for cause in causes[:1]:
            lines.append(ADVICE[cause].format(layer=limits.min_layer_time, flow=limits.flow) + ".")
    step = recommended(found)
    gain = 1.0 - step.raised.seconds / found.original.seconds
    faster = f"{100.0 * gain:.0f} % faster" if gain > 0.0 else "no faster"
    lines.append(
        f"Next, as exact as the file today and {faster}: hframe-post convert "
        f"--max-error {1e3 * step.bound:.3g}um --speed-up max"
    )
    return list(dict.fromkeys(lines))


def recommended(found: Curve) -> Step:
    """Return the step with the largest bound that no feature exceeds today, or the first."""
    today = max(found.original.errors.values())
    return [step for step in found.steps if step.bound <= 1.01 * today or step is found.steps[0]][
        -1
    ]


def _binding(point: Point) -> list[str]:
    """Return what limits the speed, the longest time first."""
    total = sum(point.limited_by.values()) or 1.0
    shares = {cause: seconds / total for cause, seconds in point.limited_by.items()}
    named = [cause for cause, share in shares.items() if share >= NAMED and cause != "travel"]
    return sorted(named, key=lambda cause: -shares[cause])


def causes(point: Point) -> str:
    """Return what limits the speed most."""
    return ", ".join(CAUSES[cause] for cause in _binding(point)[:2])


def _time(point: Point, before: float) -> str:
    change = 100.0 * (point.seconds / before - 1.0) if before else 0.0
    return f"{duration(point.seconds)} ({change:+.0f} %)"


def _errors(point: Point, name: str) -> list[str]:
    errors = point.errors
    return [_um(errors.ours, name), _um(errors.shaped, name)]


def _um(errors: dict[str, float], name: str) -> str:
    return f"{1e3 * errors[name]:.3g} µm" if name in errors else ""
