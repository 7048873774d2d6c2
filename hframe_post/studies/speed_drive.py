"""Trial prints: set speeds and accelerations by feature, convert, and judge the error.

print, or pieces of it ──► paces ──► plan ──► commands ──► error of each feature on each plant
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property

from hframe_post.conversion.options import Options
from hframe_post.conversion.pipeline import Chain, Stages, Trial, prepared, stop_solvers
from hframe_post.conversion.report import Report
from hframe_post.errors import HframeError, PrinterError
from hframe_post.firmware.registry import firmware
from hframe_post.model.plant import Plant
from hframe_post.planner.pacing import CORNER, FIRST_LAYERS, Pace, Paces, PieceStart, pace
from hframe_post.planner.sliced import AsSliced
from hframe_post.prediction.predict import judge
from hframe_post.prediction.statistics import ErrorStatistics, Labels
from hframe_post.printer.settings import Printer
from hframe_post.stream.features import TRAVEL
from hframe_post.stream.types import Item, Moves
from hframe_post.studies.inputs import SECONDS, Piece, Section, excerpt, sections, useful_feeds
from hframe_post.studies.speed_trial import (
    JUDGED_EVERY,
    Freedom,
    Measure,
    SpeedSettings,
    TrialMeter,
    TrialMeters,
    TrialPrint,
    TrialSums,
    add_layer_times,
    judged,
)

JERK = 1e7  # mm/s³; searches for another gave no faster prints
MOST_KEPT = 300_000  # moves of a file that are kept between trials; 20 MB
FEW = 0.3  # share of the time of layers that are planned again on their own
TRAVEL_SHARE = 4.0  # acceleration of travel over that of the gentlest feature

Source = Callable[[], Iterable[bytes]]  # opens the file and yields its lines, at each call again
Convert = Callable[[Printer, Trial], Report]  # converts the file


@dataclass(frozen=True, slots=True)
class Original:
    """The file's own print, not compensated: seconds, seconds by layer, error (mm) by feature."""

    seconds: float
    layers: dict[int, float]
    errors: dict[str, float]


class Drive:
    """Trial prints of one file on one printer.

    measure: the statistic of the errors. width: whether lines' width is one of them.
    """

    def __init__(
        self, lines: Source, printer: Printer, options: Options, measure: Measure,
        freedom: Freedom, width: bool = False,
    ) -> None:  # fmt: skip
        self._lines, self._printer, self._width = lines, printer, width
        self._kept: list[Item] | None = None
        self._measure, self._freedom = measure, freedom
        self._options = replace(options, predict=(), clamp=True)
        self._compensator = prepared(printer)
        self._at_stops = stop_solvers(Chain(printer, options), self._compensator)
        self.max_acceleration, self._max_corner = printer.fastest_path

    def configured(self, settings: SpeedSettings) -> tuple[Printer, Paces]:
        """Return a printer and paces that print with these settings."""
        kinds = {
            name: self._pace(settings, acceleration, settings.feed[name])
            for name, acceleration in settings.acceleration.items()
        }
        # The ringing at the end of a travel is printed, so travel must be gentle, too.
        travel = TRAVEL_SHARE * min(settings.acceleration.values())
        kinds[TRAVEL] = self._pace(settings, travel, self._freedom.speed_up)
        limits = self._printer.limits
        highest = max(limits.acceleration, *(p.acceleration for p in kinds.values()))
        corner = max(limits.square_corner_velocity, *(p.corner for p in kinds.values()))
        limits = replace(
            limits, acceleration=highest, deceleration=math.inf, jerk=JERK,
            square_corner_velocity=corner,
        )  # fmt: skip
        paces = Paces(
            kinds, self._freedom.flow, FIRST_LAYERS, settings.layer_feed,
            self._freedom.filament_acceleration, self._freedom.min_speed,
        )  # fmt: skip
        return replace(self._printer, limits=limits), paces

    def _pace(self, settings: SpeedSettings, acceleration: float, feed: float) -> Pace:
        """Return a pace; corner speed grows with the acceleration, so corners keep their shape."""
        acceleration = min(acceleration, self.max_acceleration)
        return Pace(acceleration, min(CORNER * acceleration, self._max_corner), feed)

    # ------------------------------------------------------------------ trials

    def excerpt(self, seconds: tuple[float, float] = SECONDS) -> list[Piece]:
        """Return pieces from all over the print. seconds: least and most to keep."""
        advance = firmware(self._printer).advance()
        return excerpt(self._items(), FIRST_LAYERS, seconds, advance)

    def useful_feeds(self, pieces: Iterable[Piece]) -> dict[str, float]:
        """Return the factor on each feature's feed rates beyond which nothing gets faster."""
        return useful_feeds(pieces, self._printer.limits.velocity, self._freedom.flow)

    @property
    def speed_up(self) -> float:
        """Return the greatest factor on the file's feed rates."""
        return self._freedom.speed_up

    def try_pieces(
        self, pieces: Iterable[Piece], settings: SpeedSettings, plants: tuple[Plant, ...]
    ) -> TrialPrint:
        sums, refused = self._sums(settings), ""
        printer, paces = self.configured(settings)
        chain = Chain(printer, self._options)
        stages = Stages(chain, self._compensator, at_stops=self._at_stops)
        try:
            for piece in pieces:
                items = pace(iter(piece.items), paces, piece.start)
                followed = chain.following(piece.advance)
                commands = stages.commands(chain.scheduled(items, followed))
                meter = TrialMeter(
                    sums, plants, self._options.strategy, piece.start.place, self._width
                )
                for _ in meter.samples(stages.advanced(commands, piece.advance)):
                    pass
        except HframeError as error:
            refused = str(error)
        return sums.trial(stages.ledger.clamped.samples, refused)

    def try_whole(
        self, settings: SpeedSettings, plants: tuple[Plant, ...], convert: Convert
    ) -> tuple[TrialPrint, Report | None]:
        """Convert the whole file; return what it is on each plant, and its report.

        The report is None if the print is refused. Raises PrinterError.
        """
        printer, paces = self.configured(settings)
        sums = self._sums(settings)
        meters = TrialMeters(sums, plants, self._options.strategy, self._width)
        try:
            report = convert(printer, Trial(paces, meters))
        except PrinterError:
            raise
        except HframeError as error:  # not from the file, which was read to its end before
            return sums.trial(0, str(error)), None
        return report.metered.trial(report.clamped.samples), report

    def _sums(self, settings: SpeedSettings) -> TrialSums:
        return TrialSums(settings, self._freedom, self._measure, self.max_acceleration)

    def layer_times(self, settings: SpeedSettings) -> dict[int, float]:
        """Return the seconds of each layer by its number, planned without compensation."""
        return self._layer_times(self._items(), settings, PieceStart())

    def layer_times_again(
        self, settings: SpeedSettings, before: SpeedSettings, layers: dict[int, float]
    ) -> dict[int, float]:
        """Return the seconds of each layer where only the feed rates of some layers changed.

        layers: seconds of each before. Only sections with layers that changed are planned again, at
        both settings, so that what their ends cost does not count.
        """
        feeds, old = settings.layer_feed, before.layer_feed
        changed = {k for k in feeds | old if feeds.get(k, 1.0) != old.get(k, 1.0)}
        share = sum(layers.get(k, 0.0) for k in changed) / (sum(layers.values()) or 1.0)
        if self._kept is None or share > FEW:
            return self.layer_times(settings)
        layers = dict(layers)
        for section in self._sections:
            if changed.isdisjoint(section.layers):
                continue
            for sign, each in ((1.0, settings), (-1.0, before)):
                times = self._layer_times(section.items, each, section.start)
                for layer, seconds in times.items():
                    layers[layer] = layers.get(layer, 0.0) + sign * seconds
        return layers

    @cached_property
    def _sections(self) -> list[Section]:
        return list(sections(self._items(), FIRST_LAYERS))

    def _layer_times(
        self, items: Iterable[Item], settings: SpeedSettings, start: PieceStart
    ) -> dict[int, float]:
        printer, paces = self.configured(settings)
        chain = Chain(printer, replace(self._options, retract="standing"))
        planned = chain.scheduled(pace(items, paces, start))
        labels, layers = Labels(replace(start.place), by_name=False), dict[int, float]()
        for chunk in chain.sampled(planned):
            add_layer_times(layers, labels.number(chunk)[0])
        return layers

    def original(self) -> Original:
        """Return what the file is without this tool, at its own speeds."""
        sliced = AsSliced(firmware(self._printer).limits())
        commands = sliced.samples(self._items())
        labels, layers = Labels(by_name=False), dict[int, float]()
        statistics: dict[str, ErrorStatistics] = {}
        for judgement in judge(commands, self._printer.plant, JUDGED_EVERY):
            layer, feature = labels.number(judgement.chunk)
            add_layer_times(layers, layer)
            for name, here in judged(judgement.at, layer, feature, labels):
                errors = statistics.setdefault(name, ErrorStatistics())
                errors.add(judgement.contour["none"][here])
        found = {name: errors.measured(self._measure) for name, errors in statistics.items()}
        return Original(sliced.seconds, layers, found)

    def _items(self) -> Iterator[Item]:
        """Yield the items of the file, which is read once if they take little memory."""
        return self._read() if self._kept is None else iter(self._kept)

    def _read(self) -> Iterator[Item]:
        kept, moves = list[Item](), 0
        for item in Chain(self._printer, self._options).parsed(self._lines()):
            moves += len(item.line) if isinstance(item, Moves) else 1
            if moves <= MOST_KEPT:
                kept.append(item)
            yield item
        if moves <= MOST_KEPT:
            self._kept = kept
