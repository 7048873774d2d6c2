"""One way to drive a print, and what came of it: time, what bound it, and errors by kind."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from hframe_post.arrays import TS, Array, E, Flags, Integers
from hframe_post.model.plant import Plant
from hframe_post.planner.pacing import NAMES
from hframe_post.prediction.predict import Judgement, judge
from hframe_post.prediction.statistics import TRAVEL as NOT_LAID
from hframe_post.prediction.statistics import ErrorStatistics, Labels
from hframe_post.stream.chunks import branches, smaller
from hframe_post.stream.features import KINDS, OTHER, TRAVEL, kind
from hframe_post.stream.types import Samples

Measure = Literal["rms", "p95", "peak"]
KEPT = ("bridge", "ironing", "interface", "skirt")  # kinds that keep what the file has
DRIVEN = tuple(name for name in (*KINDS, OTHER) if name not in KEPT)
JUDGED_EVERY = 4  # samples
AT_ONCE = 8192  # samples, which all plants hold
CAUSES = (
    "file",
    "cooling",
    "travel",
    "flow",
    "extruder",
    "feed",
    "motors",
    "error",
)  # the first counts
FIRST = 1  # layers that keep what the file has
FEW = 50  # judged samples below which a kind says nothing of itself
AT_LIMIT = 0.95  # share of the flow that counts as all of it
STEADY = 0.02  # share of a pace's acceleration below which the path is at cruise speed


@dataclass(frozen=True, slots=True)
class Freedom:
    """What may be changed. speed_up: times the file's feed rates, at most.

    flow: mm of filament a second, at most, where the feed is raised; min_layer_time: s;
    filament_acceleration: mm/s² of filament, at most, where the acceleration is raised.
    """

    speed_up: float = 1.0
    flow: float = np.inf
    min_layer_time: float = 0.0
    filament_acceleration: float = np.inf


AS_IT_IS = Freedom()  # feed rates of the file


@dataclass(frozen=True, slots=True)
class Driven:
    """How hard a print is driven.

    acceleration: of each kind (mm/s²); feed: times the file's, of each kind; jerk: of the path
    (mm/s³); corner: mm/s at square corners of what has CORNER_AT; travel: times the acceleration
    of the gentlest kind; slowed: factor on the feed of layers, by place in the print from 1.
    """

    acceleration: dict[str, float]
    feed: dict[str, float]
    jerk: float
    corner: float = 5.0
    travel: float = 1.0
    slowed: dict[int, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Trial:
    """One way to drive a print, and what it gave.

    errors: by kind (mm), of each plant that it was judged on, the model first; seconds: of it
    all, and of its layers by place; held (NAMES, CAUSES): seconds by kind and by what kept them
    from being fewer; clamped: samples at which a command had to be taken back; refused: why it
    cannot be driven so at all.
    """

    driven: Driven
    errors: dict[str, list[float]]
    seconds: float
    layers: dict[int, float]
    held: Array
    clamped: int
    refused: str = ""

    @property
    def held_by(self) -> dict[str, float]:
        """Seconds by what kept them from being fewer."""
        return dict(zip(CAUSES, self.held.sum(axis=0).tolist(), strict=True))


class Seen:
    """What is seen of a print, or of one piece after another."""

    def __init__(self, driven: Driven, free: Freedom, measure: Measure, top: float) -> None:
        self._driven, self._free, self._measure, self._top = driven, free, measure, top
        self._statistics: dict[str, list[ErrorStatistics]] = {}
        self._samples = 0
        self._layers: dict[int, float] = {}
        self._held = np.zeros((len(NAMES), len(CAUSES)))

    def add(self, commands: Iterable[Samples], labels: Labels, plants: tuple[Plant, ...]) -> None:
        """Takes a stream of commands of one strategy."""
        streams = branches(smaller(commands, AT_ONCE), len(plants))
        each = [judge(*pair, JUDGED_EVERY) for pair in zip(streams, plants, strict=True)]
        for judgements in zip(*each, strict=True):
            layer, feature = labels.number(judgements[0].chunk)
            self._samples += len(layer)
            count(self._layers, layer)
            self._held += self._causes(judgements[0].chunk, labels, layer, feature)
            for name, here in judged(judgements[0], layer, feature, labels):
                of = self._statistics.setdefault(name, [ErrorStatistics() for _ in plants])
                for judgement, errors in zip(judgements, of, strict=True):
                    (contour,) = judgement.contour.values()
                    errors.add(contour[here])

    def trial(self, clamped: int, refused: str = "") -> Trial:
        """Of all that was taken."""
        errors = {
            name: [measured(errors, self._measure) for errors in of]
            for name, of in self._statistics.items()
            if of[0].count >= FEW
        }
        seconds = self._samples * TS
        return Trial(self._driven, errors, seconds, self._layers, self._held, clamped, refused)

    def _causes(self, chunk: Samples, labels: Labels, layer: Integers, feature: Integers) -> Array:
        """Seconds of a chunk, (NAMES, CAUSES): by kind, and by the first cause that holds."""
        names = [TRAVEL if name == NOT_LAID else kind(name) for name in labels.features]
        kinds = np.array([NAMES.index(name) for name in names])[feature]
        of_kind = [min(self._driven.acceleration.get(name, np.inf), self._top) for name in NAMES]
        acceleration = np.array(of_kind)[kinds]
        speed = np.sqrt(np.square(np.diff(chunk.xyze[:, :E], axis=0)).sum(axis=1)) / TS
        change = np.abs(np.diff(speed, prepend=speed[:1])) / TS
        rate = np.diff(chunk.xyze[:, E], prepend=chunk.xyze[:1, E]) / TS
        fed = np.diff(rate, prepend=rate[:1]) / TS
        holds = {
            "file": np.isin(NAMES, KEPT)[kinds] | (layer <= FIRST),
            "cooling": np.isin(layer, list(self._driven.slowed)),
            "travel": kinds == NAMES.index(TRAVEL),
            "flow": rate >= AT_LIMIT * self._free.flow,
            "extruder": np.abs(fed) >= AT_LIMIT * self._free.filament_acceleration,
            "feed": np.append(change < STEADY * acceleration[1:], True)[: len(layer)],
            "motors": acceleration >= self._top,
        }
        cause = np.select(list(holds.values()), range(len(holds)), len(holds))
        shape = len(NAMES), len(CAUSES)
        count = np.bincount(kinds * len(CAUSES) + cause, minlength=len(NAMES) * len(CAUSES))
        return np.asarray(TS * count.reshape(shape))


def count(seconds: dict[int, float], layer: Integers) -> None:
    """Adds the time of samples, (n,), to their layers'."""
    for number, samples in enumerate(np.bincount(layer)):
        if samples:
            seconds[number] = seconds.get(number, 0.0) + TS * float(samples)


def judged(
    judgement: Judgement, layer: Integers, feature: Integers, labels: Labels
) -> Iterator[tuple[str, Flags]]:
    """Kinds that can be driven, and which of the judged samples (k,) are theirs."""
    here, later = feature[judgement.at], layer[judgement.at] > FIRST
    for number in np.unique(here).tolist():
        name = labels.features[number]
        if name != NOT_LAID and kind(name) in DRIVEN:
            yield kind(name), (here == number) & later


def measured(errors: ErrorStatistics, measure: Measure) -> float:
    """What is told of errors, mm."""
    if measure == "rms":
        return errors.rms
    return errors.peak if measure == "peak" else errors.percentile(0.95)
