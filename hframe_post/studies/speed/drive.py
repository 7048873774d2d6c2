"""A print driven in some way: each kind of feature as hard as is said, and judged by its error.

print, or pieces of it ──► paces ──► plan ──► commands ──► error of each kind on each plant
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

from hframe_post.compensation.stops import stop_solvers
from hframe_post.conversion.pipeline import (
    Commands,
    Options,
    Stages,
    parsed,
    planned,
    prepared,
    sampled,
)
from hframe_post.errors import HframeError
from hframe_post.model.plant import Plant
from hframe_post.planner.lookahead import plan
from hframe_post.planner.pacing import Pace, Paces, pace
from hframe_post.prediction.predict import judge
from hframe_post.prediction.statistics import ErrorStatistics, Labels
from hframe_post.printer.settings import Printer
from hframe_post.stream.features import TRAVEL
from hframe_post.studies.speed.excerpt import Piece, excerpt, hurry
from hframe_post.studies.speed.trial import (
    FIRST,
    JUDGED_EVERY,
    Driven,
    Freedom,
    Measure,
    Seen,
    Trial,
    count,
    judged,
    measured,
)

Lines = Callable[[], Iterable[bytes]]  # the file's lines anew at each call
OF_BELTS = 0.5  # of the belts' acceleration that the path may have; compensation needs the rest
CORNER_AT = 1e4  # mm/s²; speeds at corners grow with the acceleration, which keeps their shape


@dataclass(frozen=True, slots=True)
class Original:
    """The print as the file has it, without compensation: seconds, of layers too, and errors."""

    seconds: float
    layers: dict[int, float]
    errors: dict[str, float]


class Drive:
    """A print on a printer, to be driven. measure: what of the error is told."""

    def __init__(
        self, lines: Lines, printer: Printer, options: Options, measure: Measure, free: Freedom
    ) -> None:
        self._lines, self._printer, self._measure, self._free = lines, printer, measure, free
        self._options = replace(options, predict=(), clamp=True, paces=None)
        self._asked = options
        self._compensator = prepared(printer)
        self._at_stops = stop_solvers(self._compensator, options.strategies, printer)
        self.top = OF_BELTS * printer.motors.belt_acceleration * printer.kinematics.max_speed_ratio

    def settings(self, driven: Driven) -> tuple[Printer, Options]:
        """A printer and options under which the print is driven so."""
        kinds = {
            name: self._pace(driven, a, driven.feed[name])
            for name, a in driven.acceleration.items()
        }
        gentlest = min(driven.acceleration.values())  # what rings at a travel's end is printed
        kinds[TRAVEL] = self._pace(driven, driven.travel * gentlest, self._free.speed_up)
        own = self._printer.limits
        limits = replace(
            own, jerk=driven.jerk,
            acceleration=max(own.acceleration, *(p.acceleration for p in kinds.values())),
            square_corner_velocity=max(
                own.square_corner_velocity, *(p.corner for p in kinds.values())
            ),
        )  # fmt: skip
        paces = Paces(
            kinds, self._free.flow, FIRST, driven.slowed, self._free.filament_acceleration
        )
        printer = replace(self._printer, limits=limits)
        return printer, replace(self._asked, paces=paces)

    def _pace(self, driven: Driven, acceleration: float, feed: float) -> Pace:
        acceleration = min(acceleration, self.top)
        corner = driven.corner * acceleration / CORNER_AT
        return Pace(acceleration, corner, feed)

    # ------------------------------------------------------------------ trials

    def excerpt(self) -> list[Piece]:
        """Pieces that stand for the print."""
        return excerpt(parsed(self._lines(), self._printer, self._options), FIRST)

    def hurry(self, pieces: Iterable[Piece]) -> dict[str, float]:
        """Times its feed, the fastest that each kind can be."""
        return hurry(pieces, self._printer.limits.velocity, self._free.flow)

    def of_pieces(
        self, pieces: Iterable[Piece], driven: Driven, plants: tuple[Plant, ...]
    ) -> Trial:
        """Pieces driven so, judged on each plant."""
        printer, options = self.settings(driven)
        seen = Seen(driven, self._free, self._measure, self.top)
        stages = Stages(
            printer, self._options, self._compensator, self._options.strategies, self._at_stops
        )
        refused = ""
        try:
            for piece in pieces:
                assert options.paces is not None
                items = pace(piece.items, options.paces, piece.start)
                commands = stages.commands(plan(items, printer.limits))
                seen.add(commands, Labels(replace(piece.start.place), by_name=False), plants)
        except HframeError as error:
            refused = str(error)
        return seen.trial(stages.summary.clamped.samples, refused)

    def of_all(self, driven: Driven, plants: tuple[Plant, ...]) -> Trial:
        """The whole print driven so, judged on each plant."""
        printer, options = self.settings(driven)
        options = replace(self._options, paces=options.paces)
        commands = Commands(self._lines(), printer, options, compensator=self._compensator)
        seen = Seen(driven, self._free, self._measure, self.top)
        try:
            seen.add(commands, Labels(by_name=False), plants)
        except HframeError as error:  # the file itself was read to its end before
            return seen.trial(0, str(error))
        return seen.trial(commands.report().clamped.samples)

    def layers(self, driven: Driven) -> dict[int, float]:
        """Seconds of each layer, by place in the print: planned, not compensated."""
        printer, options = self.settings(driven)
        options = replace(options, retract="standing")
        items = planned(self._lines(), printer, options)
        labels, layers = Labels(by_name=False), dict[int, float]()
        for chunk in sampled(items, printer, options):
            count(layers, labels.number(chunk)[0])
        return layers

    def original(self) -> Original:
        """The print as the file has it."""
        options = replace(self._options, strategy="none")
        commands = Commands(self._lines(), self._printer, options, compensator=self._compensator)
        labels, layers = Labels(by_name=False), dict[int, float]()
        statistics: dict[str, ErrorStatistics] = {}
        for judgement in judge(commands, self._printer.plant, JUDGED_EVERY):
            layer, feature = labels.number(judgement.chunk)
            count(layers, layer)
            for name, here in judged(judgement, layer, feature, labels):
                of = statistics.setdefault(name, ErrorStatistics())
                of.add(judgement.contour["none"][here])
        told = {name: measured(of, self._measure) for name, of in statistics.items()}
        return Original(commands.report().time.before, layers, told)
