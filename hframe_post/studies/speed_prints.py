"""Prints of a file within a bound, in the steps of a conversion with that bound.

Both begin with the settings that the search on an excerpt finds, and change them until the whole
print is within the bound. These first settings are converted: at all bounds of a short print, at
the first two of a long one. At other settings the whole print is planned, so that its time is
exact, and its errors are those of the excerpt. How much greater those of the whole print are, is
interpolated between what was converted.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

from hframe_post.compensation.shape import SHAPER, shape
from hframe_post.conversion.report import Report
from hframe_post.model.plant import Plant
from hframe_post.model.shapers import Shaping
from hframe_post.prediction.error_meter import Lines
from hframe_post.prediction.predict import judge
from hframe_post.prediction.statistics import ErrorStatistics, Labels
from hframe_post.stream.types import Samples
from hframe_post.studies.inputs import Piece
from hframe_post.studies.speed_drive import Convert, Drive
from hframe_post.studies.speed_search import LayerTimes, fastest_whole
from hframe_post.studies.speed_steps import LIMIT, Bound, ExcerptSearch
from hframe_post.studies.speed_trial import (
    JUDGED_EVERY,
    Measure,
    SpeedSettings,
    TrialPrint,
    judged,
)

FEWEST = 2  # conversions, since the errors of all others lie between
MOVES = 150_000  # that are converted where FEWEST have less

Values = dict[str, list[float]]  # by feature and plant, the model first
Ratios = dict[str, tuple[float, float]]  # by feature: of the model's values, and of the greatest


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


class ExcerptErrors:
    """Errors of pieces of a print, with compensation and with an input shaper."""

    def __init__(
        self, pieces: Sequence[Piece], plant: Plant, strategy: str, shaping: Shaping | None,
        measure: Measure,
    ) -> None:  # fmt: skip
        self._pieces, self._plant, self._strategy = pieces, plant, strategy
        self._shaping, self._measure = shaping, measure

    def at(self, drive: Drive, settings: SpeedSettings | None) -> Errors:
        """Return the errors. settings: None for the file's own speeds."""
        errors: dict[str, dict[str, ErrorStatistics]] = defaultdict(dict)
        width = ErrorStatistics()
        for piece, commands in drive.print_pieces(self._pieces, settings)[1]:
            if self._shaping is not None:
                commands = shape(commands, {SHAPER: self._shaping})
            self._judge(piece, commands, errors, width)
        found = {
            strategy: {name: one.measured(self._measure) for name, one in by_name.items()}
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
            for name, here in judged(judgement.at, layer, feature, labels):
                for strategy, contour in judgement.contour.items():
                    errors[strategy].setdefault(name, ErrorStatistics()).add(contour[here])
            for strategy, (_, shares) in lines.pieces(judgement).items():
                if strategy == self._strategy:
                    width.add(shares)


class Prints:
    """Prints of one file with one freedom.

    least: of its layers. errors: of its excerpt. convert: the file, unwritten.
    """

    def __init__(
        self, drive: Drive, search: ExcerptSearch, least: LayerTimes, errors: ExcerptErrors,
        convert: Convert,
    ) -> None:  # fmt: skip
        self._drive, self._search, self._least = drive, search, least
        self._errors, self._convert = errors, convert
        self._ratios: dict[float, tuple[Ratios, Ratios]] = {}
        self._known: list[tuple[SpeedSettings, Point]] = []

    def within(self, bound: Bound) -> Point:
        """Return the print within a bound, or raise HframeError."""
        settings, plants = self._search.fastest(bound)
        for begun, point in self._known:
            if begun == settings and point.worst <= LIMIT * bound.others:
                return point  # nothing but the bound of an earlier one is less
        converts = len(self._ratios) < max(FEWEST, MOVES // self._drive.moves)

        def attempt(settings: SpeedSettings) -> tuple[TrialPrint, Report | None]:
            if converts and bound.others not in self._ratios:
                return self._converted(settings, plants, bound.others)
            return self._estimated(settings, plants, bound.others), None

        whole, _ = fastest_whole(self._drive, bound, settings, self._least, attempt)
        ours = {name: errors[0] for name, errors in whole.errors.items()}
        worst = max((max(errors) for errors in whole.errors.values()), default=0.0)
        errors = replace(self._errors.at(self._drive, whole.settings), ours=ours)
        point = Point(whole.seconds, worst, errors, whole.limited_by)
        self._known.append((settings, point))
        return point

    def _converted(
        self, settings: SpeedSettings, plants: tuple[Plant, ...], bound: float
    ) -> tuple[TrialPrint, Report | None]:
        """Convert the whole print; note how much greater its errors are than the excerpt's."""
        whole, report = self._drive.try_whole(settings, plants, self._convert)
        if not whole.refused:
            trial = self._search.tried(settings, plants)
            self._ratios[bound] = (
                _ratios(whole.errors, trial.errors), _ratios(whole.widths, trial.widths),
            )  # fmt: skip
        return whole, report

    def _estimated(
        self, settings: SpeedSettings, plants: tuple[Plant, ...], bound: float
    ) -> TrialPrint:
        """Return the whole print at these settings as its plan and the excerpt show it."""
        trial = self._drive.try_pieces(self._search.pieces, settings, plants)
        if trial.refused:
            return trial
        errors, widths = map(_scaled, (trial.errors, trial.widths), self._between(bound))
        return replace(self._drive.timed(settings), errors=errors, widths=widths)

    def _between(self, bound: float) -> tuple[Ratios, Ratios]:
        """Return the ratios of errors and widths at a bound, by those known nearest to it."""
        low = max((one for one in self._ratios if one <= bound), default=min(self._ratios))
        high = min((one for one in self._ratios if one >= bound), default=max(self._ratios))
        part = math.log(bound / low) / math.log(high / low) if low < bound < high else 0.0
        errors, widths = (
            {
                name: (a * (c / a) ** part, b * (d / b) ** part)
                for name, (a, b) in one.items()
                for c, d in [other.get(name, (a, b))]
            }
            for one, other in zip(self._ratios[low], self._ratios[high], strict=True)
        )
        return errors, widths


def _ratios(whole: Values, excerpt: Values) -> Ratios:
    """Return how much greater the values of the whole print are than those of its excerpt."""
    return {
        name: (
            max(values[0], 1e-9) / max(excerpt[name][0], 1e-9),
            max(*values, 1e-9) / max(*excerpt[name], 1e-9),
        )
        for name, values in whole.items()
        if name in excerpt
    }


def _scaled(excerpt: Values, ratios: Ratios) -> Values:
    scaled = Values()
    for name, (own, *others) in excerpt.items():
        model, greatest = ratios.get(name, (1.0, 1.0))
        scaled[name] = [model * own, *(greatest * value for value in others)]
    return scaled
