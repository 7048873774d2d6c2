"""How hard a path is driven, and how hard its motors: time against error under model error.

    pieces of a print ──► planned with each acceleration, deceleration and jerk ──► each window
    ──► time and error ──► those that no other beats in both ──► the one that is worth its time

A gentle path excites less vibration, so an error of the model matters less; it costs time. That is
worth it where it halves the error for a tenth of the time (PAID) or less. Braking counts most: what
it excites crosses the path after the corner.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import product

from hframe_post.conversion.options import Options
from hframe_post.conversion.pipeline import parsed, sampled
from hframe_post.model.lpfbs import Window
from hframe_post.model.plant import Plant
from hframe_post.planner.lookahead import plan
from hframe_post.printer.settings import Limits, Motors, Printer
from hframe_post.stream.chunks import ended, successive
from hframe_post.studies.inputs import Piece, excerpt
from hframe_post.studies.tuning.tune import Trial, tried

JERKS = (2e5, 5e5, 2e6, 5e7)  # mm/s³
# times the profile's acceleration, to speed up and to brake
SHARES = ((0.25, 0.25), (0.5, 0.5), (1.0, 0.25), (1.0, 0.5), (1.0, 1.0))
VARIED = ("acceleration", "deceleration", "jerk")
PAID = 0.1  # share of the time that half of the error is worth
ENOUGH = 30.0  # s of a print
OTHERS = 2  # windows in addition to the recommended one


@dataclass(frozen=True, slots=True)
class Point:
    """Limits of the path, and what a window gave with them."""

    limits: Limits
    trial: Trial

    @property
    def settings(self) -> dict[str, float]:
        """Return what was varied, by the names in a profile's ``limits``."""
        return {name: getattr(self.limits, name) for name in VARIED}

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
    """Return a short part of a print's layers, read with the printer's limits.

    None are returned if nothing is extruded or no layer has a label. Raises HframeError.
    """
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
    most = printer.limits.acceleration
    usual = replace(printer.limits, deceleration=min(printer.limits.deceleration, most))
    for limits in _paths(usual):
        driven = replace(printer, limits=limits)
        plans = (plan(piece.items, limits) for piece in kept)
        pieces = (sampled(each, driven, Options("racking")) for each in plans)
        samples = successive(map(ended, pieces))  # the machine is elsewhere in between
        found += [Point(limits, trial) for trial in tried(samples, driven, grid, drawn)]
    own = next(point for point in found if point.limits == usual)
    best = front(found, printer.motors)
    return Pareto(tuple(found), own, best, min(best, key=lambda point: point.cost, default=None))


def _paths(usual: Limits) -> Iterator[Limits]:
    """Yield these limits, and those with other accelerations, decelerations and jerks."""
    a = usual.acceleration
    pairs = {(up * a, down * a) for up, down in SHARES} | {(a, usual.deceleration)}
    for (up, down), jerk in product(sorted(pairs), sorted({*JERKS, usual.jerk})):
        with suppress(ValueError):  # full speed would take minutes
            yield replace(usual, acceleration=up, deceleration=down, jerk=jerk)


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
