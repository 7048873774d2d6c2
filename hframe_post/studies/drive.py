"""A print driven in some way: each kind of feature as hard as is said, and judged by its error."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from hframe_post.arrays import TS, E, Integers
from hframe_post.conversion.pipeline import Commands, Options, prepared
from hframe_post.model.plant import Plant
from hframe_post.planner.pacing import Pace, Paces
from hframe_post.prediction.labels import TRAVEL as NOT_LAID
from hframe_post.prediction.labels import Labels
from hframe_post.prediction.predict import judge
from hframe_post.prediction.statistics import ErrorStatistics
from hframe_post.printer.settings import Printer
from hframe_post.stream.chunks import branches
from hframe_post.stream.features import TRAVEL, kind
from hframe_post.stream.types import Samples

Measure = Literal["rms", "p95", "peak"]

ACCELERATION, CORNER = 1e4, 5.0  # mm/s² and mm/s of a drive of 1
GENTLEST, HARDEST = 0.02, 4.0  # drives
OF_BELTS = 0.5  # of the belts' acceleration that the path may have; compensation needs the rest
KEPT = ("bridge", "ironing", "interface", "skirt")  # kinds that keep what the file has
JUDGED_EVERY = 8  # samples
FIRST = 1  # number that ``Labels`` gives the first layer, which keeps what the file has
AT_LIMIT = 0.95  # share of the flow that counts as all of it
FEW = 50  # judged samples below which a kind says nothing of itself


@dataclass(frozen=True, slots=True)
class Freedom:
    """What may be changed. speed_up: times the file's feed rates, at most.

    flow: mm of filament a second, at most, where the feed is raised; min_layer_time: s.
    """

    speed_up: float = 1.0
    flow: float = np.inf
    min_layer_time: float = 0.0


AS_IT_IS = Freedom()  # feed rates of the file


@dataclass(frozen=True, slots=True)
class Trial:
    """One way to drive each kind, and what it gave.

    errors: by kind (mm), of each plant that it was judged on, the model first; seconds: of the
    print, and of its layers by number; held: seconds by what kept them from being fewer.
    """

    drives: dict[str, float]
    slowed: dict[int, float]
    errors: dict[str, list[float]]
    seconds: float
    layers: dict[int, float]
    held: dict[str, float]


@dataclass(frozen=True, slots=True)
class Original:
    """The print as the file has it, without compensation: seconds, and errors by kind (mm)."""

    seconds: float
    errors: dict[str, float]


class Drive:
    """A print on a printer, to be driven. measure: what of the error is told."""

    def __init__(self, printer: Printer, options: Options, measure: Measure, free: Freedom) -> None:
        self._printer, self._options, self._measure = printer, options, measure
        self._free = free
        self._compensator = prepared(printer)
        self._top = OF_BELTS * printer.motors.belt_acceleration * printer.kinematics.reach

    def settings(
        self, jerk: float, drives: dict[str, float], slowed: dict[int, float]
    ) -> tuple[Printer, Options]:
        """A printer and options under which the print is driven so."""
        kinds = {
            name: Pace(min(drive * ACCELERATION, self._top), drive * CORNER, self._free.speed_up)
            for name, drive in drives.items()
            if name not in KEPT
        }
        hardest = max(kinds.values(), key=lambda p: p.acceleration)
        kinds[TRAVEL] = min(kinds.values(), key=lambda p: p.acceleration)  # it rings on after
        own = self._printer.limits
        limits = replace(
            own, jerk=jerk, acceleration=max(own.acceleration, hardest.acceleration),
            square_corner_velocity=max(own.square_corner_velocity, hardest.corner),
        )  # fmt: skip
        paces = Paces(kinds, self._free.flow, layers=slowed)
        digest = f"{self._printer.digest} jerk {jerk:g}"
        printer = replace(self._printer, limits=limits, digest=digest)
        return printer, replace(self._options, paces=paces)

    def trial(
        self, lines: Iterable[bytes], jerk: float, drives: dict[str, float],
        slowed: dict[int, float], plants: tuple[Plant, ...],
    ) -> Trial:  # fmt: skip
        """The print driven so, judged on each plant."""
        printer, options = self.settings(jerk, drives, slowed)
        options = replace(options, predict=(), clamp=True)
        commands = Commands(lines, printer, options, compensator=self._compensator)
        streams = branches(commands, len(plants))
        judged = [judge(*pair, JUDGED_EVERY) for pair in zip(streams, plants, strict=True)]
        labels, layers, held = Labels(), dict[int, float](), dict[str, float]()
        statistics: dict[str, list[ErrorStatistics]] = {}
        for judgements in zip(*judged, strict=True):
            chunk, at = judgements[0].chunk, judgements[0].at
            layer, feature = labels.of(chunk)
            for number in np.unique(layer).tolist():
                layers[number] = layers.get(number, 0.0) + TS * float((layer == number).sum())
            for cause, seconds in self._held(chunk, labels, layer, feature, drives, slowed):
                held[cause] = held.get(cause, 0.0) + seconds
            for number in np.unique(feature[at]).tolist():
                name = labels.features[number]
                if name == NOT_LAID or kind(name) in KEPT:
                    continue
                here = (feature[at] == number) & (layer[at] > FIRST)
                of = statistics.setdefault(kind(name), [ErrorStatistics() for _ in plants])
                for judgement, errors in zip(judgements, of, strict=True):
                    errors.add(judgement.contour[options.strategy][here])
        told = {
            name: [self._measured(errors) for errors in of]
            for name, of in statistics.items()
            if of[0].count >= FEW
        }
        later = {number - FIRST: s for number, s in layers.items() if number > FIRST}
        return Trial(drives, slowed, told, commands.duration, later, held)

    def _held(
        self, chunk: Samples, labels: Labels, layer: Integers, feature: Integers,
        drives: dict[str, float], slowed: dict[int, float],
    ) -> Iterator[tuple[str, float]]:  # fmt: skip
        """Seconds of a chunk by what kept them from being fewer, the first that holds."""
        kinds = [kind(name) for name in labels.features]
        file = np.array([name in KEPT for name in kinds])[feature] | (layer <= FIRST)
        cooled = np.isin(layer, [number + FIRST for number in slowed])
        rate = np.diff(chunk.xyze[:, E], prepend=chunk.xyze[:1, E]) / TS
        melting = rate >= AT_LIMIT * self._free.flow
        hard = [min(drives.get(name, 0.0) * ACCELERATION / self._top, 1.0) for name in kinds]
        driven = np.array([share >= 1.0 or drives.get(name, 0.0) >= HARDEST
                           for name, share in zip(kinds, hard, strict=True)])[feature]  # fmt: skip
        travels = np.array([name == NOT_LAID for name in labels.features])[feature]
        left = np.ones(len(layer), dtype=bool)
        for cause, holds in (
            ("file", file), ("cooling", cooled), ("flow", melting), ("travel", travels),
            ("motors", driven), ("error", left),
        ):  # fmt: skip
            yield cause, TS * float((left & holds).sum())
            left = left & ~holds

    def original(self, lines: Iterable[bytes]) -> Original:
        """The print as the file has it."""
        options = replace(self._options, strategy="none", predict=(), clamp=True)
        commands = Commands(lines, self._printer, options, compensator=self._compensator)
        labels, statistics = Labels(), dict[str, ErrorStatistics]()
        for judgement in judge(commands, self._printer.plant, JUDGED_EVERY):
            _, feature = labels.of(judgement.chunk)
            for number in np.unique(feature[judgement.at]).tolist():
                if (name := labels.features[number]) != NOT_LAID:
                    here = feature[judgement.at] == number
                    errors = statistics.setdefault(kind(name), ErrorStatistics())
                    errors.add(judgement.contour["none"][here])
        told = {n: self._measured(e) for n, e in statistics.items() if e.count >= FEW}
        return Original(commands.report().time.before, told)

    def _measured(self, errors: ErrorStatistics) -> float:
        if self._measure == "rms":
            return errors.rms
        return errors.peak if self._measure == "peak" else errors.percentile(0.95)
