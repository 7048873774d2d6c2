"""Print time against permitted error: the whole curve for a few conversions.

Each point is the print that a conversion with that bound begins with. At the least bound and at the
error that the file has today, it is converted; ``prints`` estimates the others.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from hframe_post.conversion.options import MAX_SPEED_UP, Options
from hframe_post.conversion.pipeline import Chain
from hframe_post.conversion.sliced_errors import SlicedFile
from hframe_post.errors import HframeError
from hframe_post.model.shapers import Shaping
from hframe_post.printer.settings import Limits, Printer
from hframe_post.stream.running import one_blas_thread, release_memory
from hframe_post.studies.speed.cooling import LayerTimes
from hframe_post.studies.speed.drive import Drive, Original, Source
from hframe_post.studies.speed.excerpt import ExcerptSearch
from hframe_post.studies.speed.prints import ExcerptErrors, Point, Prints
from hframe_post.studies.speed.search import (
    freedom_of,
    random_plants,
    unwritten,
    with_slicer_limits,
)
from hframe_post.studies.speed.steps import Bound
from hframe_post.studies.speed.trial import Measure

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
