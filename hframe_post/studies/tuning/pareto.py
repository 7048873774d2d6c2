"""How hard a path is driven, and how hard its motors: time against error under model error.

    pieces of a print ──► planned with each acceleration and jerk ──► each window and weight
    ──► time and error ──► those that no other beats in both ──► the one that is worth its time

A gentle jerk excites less vibration, so an error of the model matters less; it costs time. That is
worth it where it halves the error for a tenth of the time (PAID) or less.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import chain

from hframe_post.conversion.pipeline import Options, parsed, sampled
from hframe_post.model.lpfbs import Window
from hframe_post.model.plant import Plant
from hframe_post.planner.lookahead import plan
from hframe_post.printer.settings import Motors, Printer
from hframe_post.studies.inputs import Piece, excerpt
from hframe_post.studies.tuning.tune import Trial, tried

JERKS = (1e5, 2e5, 5e5, 2e6, 1e7, 5e7)  # mm/s³
ACCELERATIONS = (0.25, 0.5, 1.0)  # times the profile's
PAID = 0.1  # share of the time that half of the error is worth
ENOUGH = 30.0  # s of a print
OTHERS = 2  # windows in addition to the recommended one


@dataclass(frozen=True, slots=True)
class Point:
    """Acceleration (mm/s²) and jerk (mm/s³) of the path, and what a window gave with them."""

    acceleration: float
    jerk: float
    trial: Trial

    @property
    def cost(self) -> float:
        """Return the error, weighted by the time that is worth paying for less of it."""
        return float(self.trial.robust * self.trial.seconds ** (math.log(2.0) / math.log1p(PAID)))


@dataclass(frozen=True, slots=True)
class Pareto:
    """All points; the front, see ``front``; the one that is worth its time.

    usual: the first window with the profile's own limits. chosen: None if the motors can follow
    none.
    """

    points: tuple[Point, ...]
    usual: Point
    front: tuple[Point, ...]
    chosen: Point | None


def pieces(lines: Iterable[bytes], printer: Printer) -> list[Piece]:
    """Return a short part of a print, read with the printer's limits. Raises HframeError."""
    items = parsed(lines, printer, Options("racking", limits="printer"))
    kept = excerpt(items, first_layers=0)
    while len(kept) > 1 and sum(sum(p.seconds.values()) for p in kept) > ENOUGH:
        kept = kept[::2]
    return kept


def pareto(
    kept: list[Piece], printer: Printer, grid: list[tuple[Window, Window]], drawn: list[Plant]
) -> Pareto:
    """Try every window of the grid on every plan. Raises HframeError."""
    found = list[Point]()
    usual = printer.limits
    for acceleration in dict.fromkeys(share * usual.acceleration for share in ACCELERATIONS):
        for jerk in sorted({*JERKS, usual.jerk}):
            try:
                limits = replace(usual, acceleration=acceleration, jerk=jerk)
            except ValueError:  # full speed would take minutes
                continue
            driven = replace(printer, limits=limits)
            plans = (plan(piece.items, limits) for piece in kept)
            samples = chain.from_iterable(sampled(p, driven, Options("racking")) for p in plans)
            trials = tried(samples, driven, grid, drawn)
            found += [Point(acceleration, jerk, trial) for trial in trials]
    own = next(
        point
        for point in found
        if (point.acceleration, point.jerk) == (usual.acceleration, usual.jerk)
    )
    best = front(found, printer.motors)
    return Pareto(tuple(found), own, best, min(best, key=lambda point: point.cost, default=None))


def front(found: Iterable[Point], motors: Motors) -> tuple[Point, ...]:
    """Return points that motors can follow and none beats in time and error, the quickest first."""
    able = [point for point in found if point.trial.within(motors)]
    able.sort(key=lambda point: (point.trial.seconds, point.trial.robust))
    best, least = list[Point](), math.inf
    for point in able:
        if point.trial.robust < least:
            best.append(point)
            least = point.trial.robust
    return tuple(best)


def windows(trials: Iterable[Trial], best: Trial, motors: Motors) -> list[tuple[Window, Window]]:
    """Return the recommended window and the next best ones."""
    able = sorted((t for t in trials if t.within(motors)), key=lambda t: t.cost)
    others = [t for t in able if t is not best][:OTHERS]
    return [best.windows, *(trial.windows for trial in others)]
