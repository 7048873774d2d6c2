"""Settings of a trial print, and what the trial gave: time, its causes, and errors by feature."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from copy import deepcopy
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from hframe_post.arrays import TS, Array, E, Flags, Integers
from hframe_post.model.nozzle import Plants
from hframe_post.model.plant import Plant
from hframe_post.planner.pacing import ADJUSTED, FIRST_LAYERS, NAMES, UNCHANGED
from hframe_post.prediction.error_meter import Lines
from hframe_post.prediction.predict import Judgement, judge_each
from hframe_post.prediction.statistics import TRAVEL as NOT_EXTRUDED
from hframe_post.prediction.statistics import ErrorStatistics, Labels
from hframe_post.stream.chunks import smaller
from hframe_post.stream.features import TRAVEL, Place, kind
from hframe_post.stream.types import Samples

Measure = Literal["rms", "p95", "peak"]
JUDGED_EVERY = 4  # samples
# What limits the speed at a sample. Where several do, the first is counted.
CAUSES = ("file", "cooling", "travel", "flow", "extruder", "feed", "motors", "error")


@dataclass(frozen=True, slots=True)
class Freedom:
    """What the search may change.

    speed_up: greatest factor on the file's feed rates; flow: greatest feed of filament (mm/s)
    where the feed rate is raised; min_layer_time: s; filament_acceleration: greatest (mm/s²) where
    the acceleration is raised; min_speed: mm/s, below which no layer is slowed.
    """

    speed_up: float = 1.0
    flow: float = np.inf
    min_layer_time: float = 0.0
    filament_acceleration: float = np.inf
    min_speed: float = 0.0


@dataclass(frozen=True, slots=True)
class SpeedSettings:
    """Speeds and accelerations of a print.

    acceleration: by feature, mm/s²; feed: factor on the file's feed rates, by feature; layer_feed:
    factor on the feed rates of layers, by number from 1.
    """

    acceleration: dict[str, float]
    feed: dict[str, float]
    layer_feed: dict[int, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class TrialPrint:
    """Outcome of a trial print.

    errors: by feature, mm, one for each plant, the model first; widths: by how much the width of
    lines is off, as a share, the same way; seconds: duration; layers: duration by layer number;
    limited (NAMES, CAUSES): seconds by feature and by what limited the speed; clamped: samples
    whose command exceeded a limit; refused: why it cannot be printed at all.
    """

    settings: SpeedSettings
    errors: dict[str, list[float]]
    widths: dict[str, list[float]]
    seconds: float
    layers: dict[int, float]
    limited: Array
    clamped: int
    refused: str = ""

    @property
    def limited_by(self) -> dict[str, float]:
        """Return the seconds by what limited the speed."""
        return dict(zip(CAUSES, self.limited.sum(axis=0).tolist(), strict=True))


class TrialSums:
    """Statistics of a trial print, or of parts of one, over several plants at once."""

    def __init__(
        self, settings: SpeedSettings, freedom: Freedom, measure: Measure, max_acceleration: float
    ) -> None:
        self._settings, self._freedom, self._measure = settings, freedom, measure
        self._max_acceleration = max_acceleration
        self._errors: dict[str, list[ErrorStatistics]] = {}
        self._widths: dict[str, list[ErrorStatistics]] = {}
        self._samples = 0
        self._layers: dict[int, float] = {}
        self._limited = np.zeros((len(NAMES), len(CAUSES)))

    def add(
        self, judgements: list[Judgement], lines: list[Lines], labels: Labels, skipped: int
    ) -> None:
        """Add what each plant makes of a chunk.

        lines: those of each plant, if their width counts. skipped: samples left out before it.
        """
        if skipped:
            now = labels.place.layer
            self._samples += skipped
            self._layers[now] = self._layers.get(now, 0.0) + TS * skipped
            self._limited[NAMES.index(TRAVEL), CAUSES.index("travel")] += TS * skipped
        layer, feature = self._time(judgements[0].chunk, labels)
        for name, here in judged(judgements[0].at, layer, feature, labels):
            all_errors = _of_plants(self._errors, name, len(judgements))
            for judgement, errors in zip(judgements, all_errors, strict=True):
                (contour,) = judgement.contour.values()
                errors.add(contour[here])
        for k, (judgement, drawn) in enumerate(zip(judgements, lines, strict=False)):
            for at, shares in drawn.pieces(judgement).values():
                for name, here in judged(at, layer, feature, labels):
                    _of_plants(self._widths, name, len(judgements))[k].add(shares[here])

    def join(self, later: TrialSums) -> None:
        """Add the sums of what is printed next."""
        both = (self._errors, later._errors), (self._widths, later._widths)
        for own, others in both:
            for name, statistics in others.items():
                joined = zip(_of_plants(own, name, len(statistics)), statistics, strict=True)
                for errors, other in joined:
                    errors.join(other)
        self._samples += later._samples
        for layer, seconds in later._layers.items():
            self._layers[layer] = self._layers.get(layer, 0.0) + seconds
        self._limited += later._limited

    def _time(self, chunk: Samples, labels: Labels) -> tuple[Integers, Integers]:
        """Add the time of a chunk; return the numbers of layer and feature of its samples."""
        layer, feature = labels.number(chunk)
        self._samples += len(layer)
        add_layer_times(self._layers, layer)
        self._limited += self._causes(chunk, labels, layer, feature)
        return layer, feature

    def trial(self, clamped: int, refused: str = "") -> TrialPrint:
        """Return the outcome; features of fewer than 50 samples have no error."""
        enough = {name for name, each in self._errors.items() if each[0].count >= 50}
        errors, widths = (
            {
                name: [errors.measured(self._measure) for errors in statistics]
                for name, statistics in found.items()
                if name in enough
            }
            for found in (self._errors, self._widths)
        )
        seconds = self._samples * TS
        return TrialPrint(
            self._settings, errors, widths, seconds, self._layers, self._limited, clamped, refused
        )

    def _causes(self, chunk: Samples, labels: Labels, layer: Integers, feature: Integers) -> Array:
        """Return the seconds of a chunk by feature and cause, (NAMES, CAUSES)."""
        names = [TRAVEL if name == NOT_EXTRUDED else kind(name) for name in labels.features]
        kinds = np.array([NAMES.index(name) for name in names])[feature]
        top, chosen = self._max_acceleration, self._settings.acceleration
        acceleration = np.array([min(chosen.get(name, np.inf), top) for name in NAMES])[kinds]
        speed = np.sqrt(np.square(np.diff(chunk.xyze[:, :E], axis=0)).sum(axis=1)) / TS
        change = np.abs(np.diff(speed, prepend=speed[:1])) / TS
        cruising = change < 0.02 * acceleration[1:]
        rate = np.diff(chunk.xyze[:, E], prepend=chunk.xyze[:1, E]) / TS
        filament_acceleration = np.abs(np.diff(rate, prepend=rate[:1]) / TS)
        applies = {
            "file": np.isin(NAMES, UNCHANGED)[kinds] | (layer <= FIRST_LAYERS),
            "cooling": np.isin(layer, list(self._settings.layer_feed)),
            "travel": kinds == NAMES.index(TRAVEL),
            "flow": rate >= 0.95 * self._freedom.flow,
            "extruder": filament_acceleration >= 0.95 * self._freedom.filament_acceleration,
            "feed": np.append(cruising, True)[: len(layer)],
            "motors": acceleration >= top,
        }
        cause = np.select(list(applies.values()), range(len(applies)), len(applies))
        shape = len(NAMES), len(CAUSES)
        count = np.bincount(kinds * len(CAUSES) + cause, minlength=len(NAMES) * len(CAUSES))
        return np.asarray(TS * count.reshape(shape))


class TrialMeter:
    """Judges commands on several plants, on their way to the output.

    sums: to which it adds. strategy: whose commands count. place: where in the print they begin.
    width: whether it measures the width of lines, too.
    """

    def __init__(
        self, sums: TrialSums, plants: tuple[Plant, ...], strategy: str, place: Place, width: bool
    ) -> None:
        self.sums, self._plants, self._strategy = sums, Plants(plants), strategy
        self._lines = [Lines() for _ in plants if width]
        self._labels = Labels(replace(place), by_name=False)

    def samples(self, chunks: Iterable[Samples]) -> Iterator[Samples]:
        waiting, end = deque[Samples](), 0

        def chosen() -> Iterator[Samples]:
            for chunk in smaller(chunks, 8192):  # since each plant has a motion
                waiting.append(chunk)
                own = {n: xy for n, xy in chunk.commands.items() if n == self._strategy}
                yield replace(chunk, commands=own)

        for judgements in judge_each(chosen(), self._plants, JUDGED_EVERY):
            chunk = waiting.popleft()
            self.sums.add(judgements, self._lines, self._labels, chunk.first - end)
            end = chunk.end
            yield chunk


@dataclass(frozen=True, slots=True)
class TrialMeters:
    """A meter for each span of a conversion, or each piece of a print. sums: of none yet."""

    sums: TrialSums
    plants: tuple[Plant, ...]
    strategy: str
    width: bool

    def begun(self, place: Place) -> TrialMeter:
        return TrialMeter(deepcopy(self.sums), self.plants, self.strategy, place, self.width)


def add_layer_times(seconds: dict[int, float], layer: Integers) -> None:
    """Add the time of samples with these layer numbers, (n,), to their layers."""
    for number, samples in enumerate(np.bincount(layer)):
        if samples:
            seconds[number] = seconds.get(number, 0.0) + TS * float(samples)


def _of_plants(
    found: dict[str, list[ErrorStatistics]], name: str, plants: int
) -> list[ErrorStatistics]:
    """Return the statistics of a feature, one for each plant."""
    return found.setdefault(name, [ErrorStatistics() for _ in range(plants)])


def judged(
    at: Integers, layer: Integers, feature: Integers, labels: Labels
) -> Iterator[tuple[str, Flags]]:
    """Yield each adjusted feature, and which of the samples ``at`` (k,) belong to it."""
    here, later = feature[at], layer[at] > FIRST_LAYERS
    for number in np.unique(here).tolist():
        name = labels.features[number]
        if name != NOT_EXTRUDED and kind(name) in ADJUSTED:
            yield kind(name), (here == number) & later
