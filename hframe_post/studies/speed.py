"""The fastest print whose predicted error stays within a bound.

Error grows nearly in proportion to the acceleration of the path and to the speed at its
corners, and it is local: each kind of feature can be driven as hard as its own bound allows. So

 1. on the first lines of the print: the limit on jerk with which it takes the least time, and by
    how much the error grows on printers that are not quite the model;
 2. on the whole print: how hard each kind is driven, in a few rounds, by the error measured in
    the round before; and the feed of layers that would be over too soon.

What was measured last is what is taken, so its error is a prediction and no extrapolation.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from itertools import islice
from typing import Literal

import numpy as np

from hframe_post.arrays import TS, E, Integers
from hframe_post.conversion.pipeline import Commands, Options, prepared
from hframe_post.errors import HframeError
from hframe_post.model.plant import Plant
from hframe_post.planner.pacing import Pace, Paces
from hframe_post.prediction.labels import TRAVEL as NOT_LAID
from hframe_post.prediction.labels import Labels
from hframe_post.prediction.predict import judge
from hframe_post.prediction.statistics import ErrorStatistics
from hframe_post.printer.settings import Printer
from hframe_post.stream.chunks import branches
from hframe_post.stream.features import KINDS, OTHER, TRAVEL, kind
from hframe_post.stream.types import Samples

Measure = Literal["rms", "p95", "peak"]

JERKS = (3e5, 1e6, 5e7)  # mm/s³, of which the quickest is taken
ACCELERATION, CORNER = 1e4, 5.0  # mm/s² and mm/s of a drive of 1
GENTLEST, HARDEST = 0.02, 4.0  # drives
OF_BELTS = 0.5  # of the belts' acceleration that the path may have; compensation needs the rest
KEPT = ("bridge", "ironing", "interface", "skirt")  # kinds that keep what the file has
PREFIX = 2500  # lines of a print on which jerk is chosen
JUDGED_EVERY = 8  # samples
STARTS = 2  # trials over the first lines
FEW_DRAWN = 2  # printers on which a jerk is judged
ROUNDS, MOST_ROUNDS = 3, 7  # over the whole print; more only while none is within the bound
STRIDE = (0.3, 3.0)  # of one correction
AIM = 0.93  # share of a bound that is aimed at
NEAR = 0.85  # share of a bound from which a kind is as fast as it can be
FIRST = 1  # number that ``Labels`` gives the first layer, which keeps what the file has
AT_LIMIT = 0.95  # share of the flow that counts as all of it
FEW = 50  # judged samples below which a kind says nothing of itself
MOST_SPEED_UP = 20.0  # times the file's feed; what the printer allows binds long before
SLOWEST_LAYER = 0.05  # least factor on the feed of a layer


@dataclass(frozen=True, slots=True)
class Bound:
    """Errors (mm) that may not be exceeded: by kind of feature, and of all others."""

    others: float
    kinds: dict[str, float] = field(default_factory=dict)
    measure: Measure = "p95"

    def of(self, name: str) -> float:
        """The bound of a kind."""
        return self.kinds.get(name, self.others)


@dataclass(frozen=True, slots=True)
class Freedom:
    """What may be changed. speed_up: times the file's feed rates, at most.

    flow: mm of filament a second, at most, where the feed is raised; min_layer_time: s.
    """

    speed_up: float = 1.0
    flow: float = np.inf
    min_layer_time: float = 0.0


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


@dataclass(frozen=True, slots=True)
class Fastest:
    """A printer whose limits allow the pace and options that ask for it, and the prediction.

    growth: times which errors grow under model error, by kind.
    """

    printer: Printer
    options: Options
    bound: Bound
    jerk: float
    growth: dict[str, float]
    trial: Trial
    original: Original


def fastest(
    lines: Callable[[], Iterable[bytes]],
    printer: Printer,
    options: Options,
    bound: Bound,
    freedom: Freedom = Freedom(),
    drawn: tuple[Plant, ...] = (),
) -> Fastest:
    """How to print it in the least time within the bound. Raises HframeError.

    lines: gives the file's lines anew at each call. drawn: printers on which the bound must hold
    too, as far as they make the first lines' error grow.
    """
    search = _Search(printer, options, bound, freedom)
    prefix = list(islice(lines(), PREFIX))
    few = [search.start(prefix, jerk, drawn[:FEW_DRAWN]) for jerk in JERKS]
    jerk = JERKS[int(np.argmin([start.trial.seconds for start in few]))]
    start = search.start(prefix, jerk, drawn)
    found = search.within(lines, jerk, start)
    own, paced = search.settings(jerk, found.drives, found.slowed)
    return Fastest(own, paced, bound, jerk, start.growth, found, search.original(lines()))


@dataclass(frozen=True, slots=True)
class _Start:
    """A pace tried on the first lines; growth: by kind, of its error under model error."""

    trial: Trial
    growth: dict[str, float]


class _Search:
    """The print's bounds, and trials of how it can be driven."""

    def __init__(self, printer: Printer, options: Options, bound: Bound, free: Freedom) -> None:
        self._printer, self._options, self._bound, self._free = printer, options, bound, free
        self._compensator = prepared(printer)
        self._top = OF_BELTS * printer.motors.belt_acceleration * printer.kinematics.reach

    def start(self, prefix: list[bytes], jerk: float, drawn: tuple[Plant, ...]) -> _Start:
        """A first pace, from the first lines of the print, and what model error does to it."""
        plants = (self._printer.plant, *drawn)
        drives, slowed = dict.fromkeys((*KINDS, OTHER), 1.0), dict[int, float]()
        for _ in range(STARTS):
            trial = self.trial(prefix, jerk, drives, slowed, plants)
            growth = {name: max(of) / of[0] for name, of in trial.errors.items() if of[0] > 0.0}
            worst = max(growth.values(), default=1.0)  # taken for kinds that come later
            growth = {name: growth.get(name, worst) for name in trial.drives}
            drives, slowed = self._corrected(trial, growth), {**slowed, **self._short(trial)}
        return _Start(trial, growth)

    def within(
        self,
        lines: Callable[[], Iterable[bytes]],
        jerk: float,
        start: _Start,
    ) -> Trial:
        """The quickest of a few trials that is within the bound. Raises HframeError."""
        good, growth = list[Trial](), start.growth
        drives, slowed = self._corrected(start.trial, growth), start.trial.slowed
        for number in range(MOST_ROUNDS):
            trial = self.trial(lines(), jerk, drives, slowed, (self._printer.plant,))
            shares, short = self._shares(trial, growth), self._short(trial)
            if all(share <= 1.0 for share in shares.values()) and not short:
                good.append(trial)
            spent = all(share >= NEAR or drives[name] >= HARDEST for name, share in shares.items())
            if good and (spent or number + 1 >= ROUNDS):
                break
            drives, slowed = self._corrected(trial, growth), {**slowed, **short}
        if not good:
            worst = max(shares, key=lambda name: shares[name])
            least = growth.get(worst, 1.0) * trial.errors[worst][0] * 1e3
            raise HframeError(
                f"no pace keeps this print within that error: {worst} is off by {least:.0f} µm "
                "however gently it is printed, model error included; allow more"
            )
        return min(good, key=lambda t: t.seconds)

    def _shares(self, trial: Trial, growth: dict[str, float]) -> dict[str, float]:
        """How much of its bound each kind uses up."""
        return {
            name: growth.get(name, 1.0) * of[0] / self._bound.of(name)
            for name, of in trial.errors.items()
        }

    def _corrected(self, trial: Trial, growth: dict[str, float]) -> dict[str, float]:
        """Drives with which each kind should use up its bound."""
        shares = self._shares(trial, growth)
        return {
            name: float(np.clip(drive * np.clip(AIM / max(shares.get(name, AIM), 1e-9), *STRIDE),
                                GENTLEST, HARDEST))
            for name, drive in trial.drives.items()
        }  # fmt: skip

    def _short(self, trial: Trial) -> dict[int, float]:
        """New factors for the layers that are over too soon."""
        least = self._free.min_layer_time
        return {
            number: max(trial.slowed.get(number, 1.0) * (seconds / least) ** 1.3, SLOWEST_LAYER)
            for number, seconds in trial.layers.items()
            if seconds < 0.98 * least and trial.slowed.get(number, 1.0) > SLOWEST_LAYER
        }

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
        if self._bound.measure == "rms":
            return errors.rms
        return errors.peak if self._bound.measure == "peak" else errors.percentile(0.95)
