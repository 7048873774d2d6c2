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

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from itertools import islice

import numpy as np

from hframe_post.conversion.pipeline import Options
from hframe_post.errors import HframeError
from hframe_post.model.plant import Plant
from hframe_post.printer.settings import Printer
from hframe_post.stream.features import KINDS, OTHER
from hframe_post.studies.drive import (
    AS_IT_IS,
    GENTLEST,
    HARDEST,
    Drive,
    Freedom,
    Measure,
    Original,
    Trial,
)

JERKS = (3e5, 1e6, 5e7)  # mm/s³, of which the quickest is taken
PREFIX = 2500  # lines of a print on which jerk is chosen
STARTS = 2  # trials over the first lines
FEW_DRAWN = 2  # printers on which a jerk is judged
ROUNDS, MOST_ROUNDS = 3, 7  # over the whole print; more only while none is within the bound
STRIDE = (0.3, 3.0)  # of one correction
AIM = 0.93  # share of a bound that is aimed at
NEAR = 0.85  # share of a bound from which a kind is as fast as it can be
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
    freedom: Freedom = AS_IT_IS,
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
    own, paced = search.drive.settings(jerk, found.drives, found.slowed)
    return Fastest(own, paced, bound, jerk, start.growth, found, search.drive.original(lines()))


@dataclass(frozen=True, slots=True)
class _Start:
    """A pace tried on the first lines; growth: by kind, of its error under model error."""

    trial: Trial
    growth: dict[str, float]


class _Search:
    """The print's bounds, and trials of how it can be driven."""

    def __init__(self, printer: Printer, options: Options, bound: Bound, free: Freedom) -> None:
        self._plant, self._bound, self._free = printer.plant, bound, free
        self.drive = Drive(printer, options, bound.measure, free)

    def start(self, prefix: list[bytes], jerk: float, drawn: tuple[Plant, ...]) -> _Start:
        """A first pace, from the first lines of the print, and what model error does to it."""
        plants = (self._plant, *drawn)
        drives, slowed = dict.fromkeys((*KINDS, OTHER), 1.0), dict[int, float]()
        for _ in range(STARTS):
            trial = self.drive.trial(prefix, jerk, drives, slowed, plants)
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
            trial = self.drive.trial(lines(), jerk, drives, slowed, (self._plant,))
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
