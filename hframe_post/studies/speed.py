"""The fastest print whose predicted error stays within a bound, on printers a little off, too.

Error grows nearly in proportion to the acceleration of the path and to the speed at its
corners, and it is local: each kind of feature can be driven as hard as its own bound allows. So

 1. on pieces from all over the print: which of the drawn printers decide, and with which limit
    on jerk, speed at corners and hurry between features it takes the least time within the bound;
 2. by planning alone: the feed of layers that would be over too soon;
 3. on the whole print and the printers that decide: whether the bound holds. If not, or if more
    is allowed, each kind is corrected by its error, and the whole print is judged again.

What was judged last is what is taken, so its error is a prediction and no extrapolation.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from hframe_post.arrays import Array
from hframe_post.blas import one_thread
from hframe_post.conversion.pipeline import Options
from hframe_post.errors import HframeError
from hframe_post.model.plant import Plant
from hframe_post.planner.pacing import NAMES
from hframe_post.printer.settings import Printer
from hframe_post.studies.drive import (
    AS_IT_IS,
    CAUSES,
    DRIVEN,
    Drive,
    Driven,
    Freedom,
    Lines,
    Measure,
    Original,
    Trial,
)

START, JERK = 8e3, 1e6  # mm/s², mm/s³ tried first
GENTLEST = 200.0  # mm/s²
LADDERS = {  # what is tried beside the accelerations
    "jerk": (1e5, 2e5, 5e5, 1e6, 3e6, 1e7, 5e7),  # mm/s³
    "corner": (2.5, 5.0, 10.0, 20.0, 40.0),  # mm/s at CORNER_AT
    "travel": (1.0, 2.0, 4.0),  # times the gentlest kind's acceleration
}
PLANNED = 2  # times that the layers' least times are planned
ROUNDS, MOST_ROUNDS = 2, 6  # of the whole print; more only while none is within the bound
STRIDE = (0.3, 3.0)  # of one correction
HOLDS = 0.95  # share of a bound that the judged printers may use up: another may be worse
AIM = 0.92  # share that is aimed at
SAFER = 0.85  # of that share, after each round that did not keep it
TINY = 1e-9  # share of a bound, at least, to divide by
NEAR = 0.85  # share of a bound from which a kind is as fast as it can be
DECIDE = 2  # drawn printers that are judged for each kind, the worst for it
RUNG, MOST_RUNGS = 0.8, 20  # of feeds, from the greatest to the file's
SLOWEST = 0.3  # times the file's feed, where that leaves the path by too much
CHANGING = [CAUSES.index(cause) for cause in ("motors", "error")]  # held by the acceleration
MOST_SPEED_UP = 20.0  # times the file's feed; what the printer allows binds long before
SLOWEST_LAYER = 0.05  # least factor on the feed of a layer
AMPLE = 1.01  # times its least time that a slowed layer is given
STEEPER = 1.3  # power of a layer's share of its time: not all of it is spent at the feed
OUTRUN = 0.8  # of the hardest acceleration, where a motor would be outrun
QUICKER = 0.995  # share of the time from which a rung of a ladder is worth it
HARDLY = 0.05  # share of the time below which it is not worth while
IN_TIME = 0.98  # share of a layer's least time that counts as all of it


@dataclass(frozen=True, slots=True)
class Bound:
    """Errors (mm) that may not be exceeded: by kind of feature, and of all others."""

    others: float
    kinds: dict[str, float] = field(default_factory=dict)
    measure: Measure = "p95"

    def of(self, name: str) -> float:
        """The bound of a kind."""
        return self.kinds.get(name, self.others)

    def shares(self, trial: Trial) -> dict[str, float]:
        """How much of its bound each kind uses up on the worst of its printers."""
        return {name: max(of) / self.of(name) for name, of in trial.errors.items()}


@dataclass(frozen=True, slots=True)
class Fastest:
    """A printer whose limits allow the pace and options that ask for it, and the prediction.

    trial: of the whole print, on the model and on the drawn printers that decide.
    """

    printer: Printer
    options: Options
    bound: Bound
    trial: Trial
    original: Original


@one_thread()
def fastest(
    lines: Lines,
    printer: Printer,
    options: Options,
    bound: Bound,
    freedom: Freedom = AS_IT_IS,
    drawn: tuple[Plant, ...] = (),
) -> Fastest:
    """How to print it in the least time within the bound. Raises HframeError.

    lines: gives the file's lines anew at each call. drawn: printers on which the bound must hold
    too.
    """
    drive = Drive(lines, printer, options, bound.measure, freedom)
    original = drive.original()
    cooling = Cooling.of(original, freedom)
    driven, plants = _Pieces(drive, bound, (printer.plant, *drawn), freedom.speed_up).quickest()
    driven = cooling.planned(drive, driven)
    trial = _within(drive, bound, driven, plants, cooling, options.clamp)
    return Fastest(*drive.settings(trial.driven), bound, trial, original)


class _Pieces:
    """Trials on pieces of the print. everyone: the model, and the printers drawn around it."""

    def __init__(
        self, drive: Drive, bound: Bound, everyone: tuple[Plant, ...], speed_up: float
    ) -> None:
        self._drive, self._bound, self._everyone = drive, bound, everyone
        self._pieces = drive.excerpt()
        useful = drive.hurry(self._pieces)
        self._feeds = {name: max(min(speed_up, useful.get(name, speed_up)), 1.0) for name in DRIVEN}

    def quickest(self) -> tuple[Driven, tuple[Plant, ...]]:
        """How to drive the print to begin with, and the printers that decide."""
        driven = Driven(
            dict.fromkeys(DRIVEN, min(START, self._drive.top)),
            self._feeds, JERK,
        )  # fmt: skip
        driven, plants = self._judged_by_all(driven)
        best = self._slower(self._trial(driven, plants), plants)
        for name, ladder in LADDERS.items():
            best = self._climbed(best, name, ladder, plants)
        return self._judged_by_all(self._corrected(best))

    def _trial(self, driven: Driven, plants: tuple[Plant, ...]) -> Trial:
        """The pieces driven so, or gentler if that cannot be."""
        for _ in range(MOST_ROUNDS):
            trial = self._drive.of_pieces(self._pieces, driven, plants)
            if not trial.refused:
                return trial
            driven = gentler(driven)
        raise HframeError(trial.refused)

    def _judged_by_all(self, driven: Driven) -> tuple[Driven, tuple[Plant, ...]]:
        """Corrected on all printers; the model, and those that are worst for some kind."""
        trial = self._trial(driven, self._everyone)
        worst = {k for of in trial.errors.values() for k in np.argsort(of)[-DECIDE:].tolist()}
        plants = (self._everyone[0], *(self._everyone[k] for k in sorted(worst - {0})))
        return self._corrected(trial), plants

    def _corrected(self, trial: Trial) -> Driven:
        """Each kind so hard that it should use up its bound."""
        gains = {name: AIM / max(share, TINY) for name, share in self._bound.shares(trial).items()}
        return harder(trial.driven, gains, self._drive.top)

    def _slower(self, best: Trial, plants: tuple[Plant, ...]) -> Trial:
        """Each kind at a feed at which it takes less time: where a printer that is a little off
        leaves the path at speed, what is slower may change its speed harder."""
        times, feeds = self._times(best), dict(best.driven.feed)
        open_, lowered = set(times), False
        for rung in range(1, MOST_RUNGS):
            shares = self._bound.shares(best)
            least = {name: SLOWEST if shares.get(name, 0.0) > 1.0 else 1.0 for name in feeds}
            feed = {
                name: max(self._feeds[name] * RUNG**rung, least[name]) if name in open_ else own
                for name, own in feeds.items()
            }
            if feed == feeds:
                break
            tried = self._trial(replace(self._corrected(best), feed=feed), plants)
            now = self._times(tried)
            open_ = {name for name in open_ if now.get(name, np.inf) < QUICKER * times[name]}
            if not open_:
                break
            lowered, best = True, tried
            feeds |= {name: feed[name] for name in open_}
            times |= {name: now[name] for name in open_}
        return self._trial(replace(self._corrected(best), feed=feeds), plants) if lowered else best

    def _climbed(
        self, best: Trial, name: str, ladder: tuple[float, ...], plants: tuple[Plant, ...]
    ) -> Trial:
        """Up the ladder as long as it takes less time so, else down."""
        start = ladder.index(getattr(best.driven, name))
        for way in (ladder[start + 1 :], ladder[:start][::-1]):
            begun = best
            for value in way:
                changed: dict[str, Any] = {name: value}
                tried = self._trial(replace(self._corrected(best), **changed), plants)
                if not self._time(tried) < QUICKER * self._time(best):
                    break
                best = tried
            if best is not begun:
                break
        return best

    def _time(self, trial: Trial) -> float:
        """Seconds that it would take if each kind used up its bound, about."""
        own = sum(self._spent(trial, name).sum() for name in trial.errors)
        return trial.seconds - float(own) + sum(self._times(trial).values())

    def _times(self, trial: Trial) -> dict[str, float]:
        """The same, of each kind.

        Changes of speed take less with the root of the acceleration, of which there is no more
        than the motors have. What is off by too much must be slower as a whole.
        """
        times, own, top = dict[str, float](), trial.driven.acceleration, self._drive.top
        for name, share in self._bound.shares(trial).items():
            spent = self._spent(trial, name)
            changing = float(spent[CHANGING].sum())
            gain = np.log(np.clip(share, max(STRIDE[0], own[name] / top), 1.0))
            times[name] = float(spent.sum()) * max(share, 1.0) + 0.5 * changing * float(gain)
        return times

    @staticmethod
    def _spent(trial: Trial, name: str) -> Array:
        """Seconds of a kind by cause, (CAUSES,)."""
        return np.asarray(trial.held[NAMES.index(name)])


@dataclass(frozen=True, slots=True)
class Cooling:
    """The least time of each layer, by place in the print: no less than the file gives it."""

    least: dict[int, float]

    @classmethod
    def of(cls, original: Original, freedom: Freedom) -> Cooling:
        """As long as may be asked of the file's own layers."""
        most = freedom.min_layer_time
        return cls({layer: min(own, most) for layer, own in original.layers.items() if layer})

    def short(self, layers: dict[int, float]) -> dict[int, float]:
        """The layers that are over too soon: shares of their least time."""
        return {
            layer: seconds / self.least[layer]
            for layer, seconds in layers.items()
            if seconds < IN_TIME * self.least.get(layer, 0.0)
        }

    def slowed(self, driven: Driven, layers: dict[int, float]) -> Driven:
        """With other feeds in layers that took less than their time."""
        factors = {
            layer: max(driven.slowed.get(layer, 1.0) * (share / AMPLE) ** STEEPER, SLOWEST_LAYER)
            for layer, share in self.short(layers).items()
        }
        return replace(driven, slowed={**driven.slowed, **factors})

    def planned(self, drive: Drive, driven: Driven) -> Driven:
        """With feeds at which the plan leaves each layer its time."""
        for _ in range(PLANNED):
            layers = drive.layers(driven)
            if not self.short(layers):
                break
            driven = self.slowed(driven, layers)
        return driven


def _within(
    drive: Drive, bound: Bound, driven: Driven, plants: tuple[Plant, ...], cooling: Cooling,
    may_clamp: bool,
) -> Trial:  # fmt: skip
    """The quickest of a few trials of the whole print within the bound. Raises HframeError."""
    good, aims = list[Trial](), dict[str, float]()
    for number in range(1, MOST_ROUNDS + 1):
        trial = drive.of_all(driven, plants)
        shares, short = bound.shares(trial), cooling.short(trial.layers)
        allowed = HOLDS if number < MOST_ROUNDS else 1.0
        keeps = all(share <= allowed for share in shares.values())
        outruns = trial.clamped > 0 and not may_clamp and number < MOST_ROUNDS
        if trial.refused:
            driven = gentler(driven)
            continue
        if keeps and not short and not outruns:
            good.append(trial)
        if good and (number >= ROUNDS or spent(trial, shares, drive.top)):
            return min(good, key=lambda t: t.seconds)
        if not (keeps and short):  # what is driven harder would make other layers short
            gains = _gains(shares, aims)
            driven = slower(harder(driven, gains, drive.top), gains)
        driven = cooling.slowed(driven, trial.layers)
        if outruns:
            driven = gentler(driven)
    if trial.refused:
        raise HframeError(trial.refused)
    worst = max(shares, key=lambda name: shares[name])
    raise HframeError(
        f"no pace keeps this print within that error: {worst} is off by "
        f"{max(trial.errors[worst]) * 1e3:.0f} µm however gently it is printed, model error "
        "included; allow more"
    )


def _gains(shares: dict[str, float], aims: dict[str, float]) -> dict[str, float]:
    """Times its acceleration with which each kind should use up its bound.

    aims: by kind, of those that were beyond it; lowered with each time.
    """
    aims.update({k: SAFER * aims.get(k, AIM) for k, share in shares.items() if share > HOLDS})
    return {
        name: aims[name] / share if share > HOLDS
        else 1.0 if share > NEAR or name in aims
        else AIM / max(share, TINY)
        for name, share in shares.items()
    }  # fmt: skip


def harder(driven: Driven, gains: dict[str, float], top: float) -> Driven:
    """Each kind at so many times its acceleration, if the motors have it.

    Kinds that were not judged are driven as the gentlest that were.
    """
    own = driven.acceleration
    judged = {
        name: float(np.clip(own[name] * np.clip(gain, *STRIDE), GENTLEST, top))
        for name, gain in gains.items()
    }
    least = min(judged.values(), default=START)
    return replace(driven, acceleration={name: judged.get(name, least) for name in own})


def slower(driven: Driven, gains: dict[str, float]) -> Driven:
    """What shall be driven less hard, at lower feeds, too."""
    feed = {
        name: max(own * gains[name], SLOWEST) if gains.get(name, 1.0) < 1.0 else own
        for name, own in driven.feed.items()
    }
    return replace(driven, feed=feed)


def gentler(driven: Driven) -> Driven:
    """What is driven hardest, less hard, and all else a rung lower."""
    own = driven.acceleration
    hard = OUTRUN * max(own.values())
    rungs: dict[str, Any] = {
        name: ladder[max(ladder.index(getattr(driven, name)) - 1, 0)]
        for name, ladder in LADDERS.items()
    }
    return replace(driven, acceleration={name: min(a, hard) for name, a in own.items()}, **rungs)


def spent(trial: Trial, shares: dict[str, float], top: float) -> bool:
    """Whether harder driving would gain next to nothing."""
    if trial.held_by["error"] < HARDLY * trial.seconds:
        return max(shares.values(), default=0.0) <= HOLDS
    own = trial.driven.acceleration
    return all(NEAR <= share <= HOLDS or (share <= HOLDS and own[name] >= top)
               for name, share in shares.items())  # fmt: skip
