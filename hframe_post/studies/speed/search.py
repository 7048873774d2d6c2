"""Search for the fastest print whose predicted error stays within a bound.

The error grows nearly in proportion to the acceleration of the path and to the speed at its
corners, and it is local: each kind of feature can be accelerated as far as its own bound allows.
The bound holds for the model and for random printers near it. So the search

 1. prints pieces from all over the file and finds which plants have the greatest error, and which
    feed rates, jerk, corner speed and travel acceleration give the least time within the bound;
 2. plans the whole print and slows layers that need time to cool;
 3. prints the whole file on those plants. If an error is beyond its bound, or well within it, the
    acceleration of that feature is corrected and the whole file is printed again.

The result is one of the whole prints, so its error is a prediction, not an extrapolation.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any, cast

import numpy as np

from hframe_post.arrays import Array
from hframe_post.conversion.pipeline import Options
from hframe_post.errors import HframeError
from hframe_post.model.plant import Plant
from hframe_post.planner.pacing import NAMES
from hframe_post.printer.settings import Printer
from hframe_post.stream.running import one_blas_thread, release_memory
from hframe_post.studies.simulation.uncertainty import draws
from hframe_post.studies.speed.drive import Drive, LayerTimes, Lines, Original
from hframe_post.studies.speed.trial import ADJUSTED, CAUSES, Freedom, Measure, SpeedSettings, Trial

MAX_SPEED_UP = 20.0  # times the file's feed rates
ROUNDS, MAX_ROUNDS = 2, 6  # of the whole print; more than ROUNDS only until one is within bounds
LIMIT = 0.95  # share of a bound that may be used up: other printers may have a greater error
AIM = 0.92  # share of a bound to aim at
NEAR = 0.85  # share of a bound beyond which a feature is fast enough
RESTRAINT = 0.85  # factor on the aim after each round beyond the limit
QUICKER = 0.995  # share of the time below which a change is worth making
MIN_FEED = 0.3  # times the file's feed rates, where the error is too great
LADDERS = {  # values tried of the other settings
    "jerk": (1e5, 2e5, 5e5, 1e6, 3e6, 1e7, 5e7),
    "corner": (2.5, 5.0, 10.0, 20.0, 40.0),
    "travel": (1.0, 2.0, 4.0),
}


@dataclass(frozen=True, slots=True)
class Bound:
    """Greatest errors (mm): by kind of feature, and of all others."""

    others: float
    kinds: dict[str, float] = field(default_factory=dict)
    measure: Measure = "p95"

    def limit(self, name: str) -> float:
        return self.kinds.get(name, self.others)

    def shares(self, trial: Trial) -> dict[str, float]:
        """Return the share of its bound that each feature uses up on its worst plant."""
        return {name: max(errors) / self.limit(name) for name, errors in trial.errors.items()}


@dataclass(frozen=True, slots=True)
class Fastest:
    """Printer and options that make the print fast, and the trial of the whole print."""

    printer: Printer
    options: Options
    bound: Bound
    trial: Trial
    original: Original


def find_fastest(lines: Lines, printer: Printer, options: Options) -> Fastest:
    """Return the fastest print within the error that ``options.speed`` allows.

    Raises HframeError if no print is within it.
    """
    speed, limits = options.speed, printer.limits
    assert speed is not None
    errors = speed.max_error
    bound = Bound(
        errors.get("", max(errors.values())),
        {name: error for name, error in errors.items() if name},
        cast(Measure, speed.error_measure),
    )
    freedom = Freedom(
        speed.speed_up, limits.filament_velocity, limits.min_layer_time,
        speed.filament_acceleration or math.inf,
    )  # fmt: skip
    near = draws(printer.plant, speed.model_error, 40 if speed.model_error else 0, seed=0)
    found = search(lines, printer, options, bound, freedom, tuple(near))
    release_memory()
    return found


@one_blas_thread()
def search(
    lines: Lines, printer: Printer, options: Options, bound: Bound,
    freedom: Freedom | None = None, near: tuple[Plant, ...] = (),
) -> Fastest:  # fmt: skip
    """Return the fastest print within the bound, or raise HframeError.

    freedom: by default, feed rates are not raised. near: plants in addition to the printer's on
    which the bound must hold.
    """
    freedom = freedom or Freedom()
    drive = Drive(lines, printer, options, bound.measure, freedom)
    original = drive.original()
    layers = original.layers.items()
    least = LayerTimes({k: min(seconds, freedom.min_layer_time) for k, seconds in layers if k})
    pieces = _PieceSearch(drive, bound, (printer.plant, *near), freedom.speed_up)
    settings, plants = pieces.fastest()
    settings = least.planned(drive, settings)
    trial = _fastest_whole(drive, bound, settings, plants, least, options.clamp)
    return Fastest(*drive.configured(trial.settings), bound, trial, original)


def _fastest_whole(
    drive: Drive, bound: Bound, settings: SpeedSettings, plants: tuple[Plant, ...],
    least: LayerTimes, may_clamp: bool,
) -> Trial:  # fmt: skip
    """Return the fastest of a few prints of the whole file within the bound, or raise HframeError.

    Each round corrects the settings by the outcome of the one before.
    """
    accepted, aims = list[Trial](), dict[str, float]()
    for number in range(1, MAX_ROUNDS + 1):
        last_round = number == MAX_ROUNDS
        trial = drive.try_whole(settings, plants)
        if trial.refused:
            settings = _gentler(settings)
            continue
        shares, short = bound.shares(trial), least.short(trial.layers)
        within = all(share <= (1.0 if last_round else LIMIT) for share in shares.values())
        clamped = trial.clamped > 0 and not may_clamp and not last_round
        if within and not short and not clamped:
            accepted.append(trial)
        if accepted and (number >= ROUNDS or _exhausted(trial, shares, drive.max_acceleration)):
            return min(accepted, key=lambda t: t.seconds)
        if not within or not short:  # more acceleration would make further layers short
            gains = _gains(shares, aims)
            feed = {
                name: max(gains[name] * now, MIN_FEED) if gains.get(name, 1.0) < 1.0 else now
                for name, now in settings.feed.items()
            }
            settings = _accelerated(replace(settings, feed=feed), gains, drive.max_acceleration)
        if clamped and number < ROUNDS:
            milder = {name: 0.93 * a for name, a in settings.acceleration.items()}
            settings = replace(settings, acceleration=milder)
        elif clamped:
            settings = _gentler(settings)
        settings = least.planned(drive, least.slowed(settings, trial.layers))
    if trial.refused:
        raise HframeError(trial.refused)
    worst = max(shares, key=lambda name: shares[name])
    raise HframeError(
        f"this print cannot be kept within that error: even at the lowest speed tried, {worst} has "
        f"an error of {max(trial.errors[worst]) * 1e3:.0f} µm, model uncertainty included; allow "
        "more with --max-error"
    )


def _gains(shares: dict[str, float], aims: dict[str, float]) -> dict[str, float]:
    """Return the factor on each feature's acceleration with which it should use up its bound.

    aims: share of the bound to aim at, of features that were beyond it; updated here.
    """
    gains = {}
    for name, share in shares.items():
        if share > LIMIT:
            aims[name] = RESTRAINT * aims.get(name, AIM)
            gains[name] = aims[name] / share
        elif share > NEAR or name in aims:
            gains[name] = 1.0
        else:
            gains[name] = AIM / max(share, 1e-9)
    return gains


def _exhausted(trial: Trial, shares: dict[str, float], max_acceleration: float) -> bool:
    """Return whether more acceleration would gain next to nothing."""
    if trial.limited_by["error"] < 0.05 * trial.seconds:
        return max(shares.values(), default=0.0) <= LIMIT
    used = trial.settings.acceleration
    return all(
        share <= LIMIT and (share >= NEAR or used[name] >= max_acceleration)
        for name, share in shares.items()
    )


# ---------------------------------------------------------------------- changing settings


def _accelerated(settings: SpeedSettings, gains: dict[str, float], most: float) -> SpeedSettings:
    """Return settings with each feature's acceleration times its gain, from 200 to ``most`` mm/s².

    A gain counts from 0.3 to 3. Features without a gain get the least acceleration of the others.
    """
    present = settings.acceleration
    changed = {
        name: float(np.clip(present[name] * np.clip(gain, 0.3, 3.0), 200.0, most))
        for name, gain in gains.items()
    }
    least = min(changed.values(), default=8e3)
    return replace(settings, acceleration={name: changed.get(name, least) for name in present})


def _gentler(settings: SpeedSettings) -> SpeedSettings:
    """Return settings with the highest accelerations cut, and all else a rung lower."""
    present = settings.acceleration
    highest = 0.8 * max(present.values())
    lower: dict[str, Any] = {
        name: ladder[max(ladder.index(getattr(settings, name)) - 1, 0)]
        for name, ladder in LADDERS.items()
    }
    acceleration = {name: min(value, highest) for name, value in present.items()}
    return replace(settings, acceleration=acceleration, **lower)


# ---------------------------------------------------------------------- search on pieces


class _PieceSearch:
    """Search on pieces of the print. plants: the model, and random ones near it."""

    def __init__(
        self, drive: Drive, bound: Bound, plants: tuple[Plant, ...], speed_up: float
    ) -> None:
        self._drive, self._bound, self._plants = drive, bound, plants
        self._pieces = drive.excerpt()
        useful = drive.useful_feeds(self._pieces)
        self._max_feed = {
            name: max(min(speed_up, useful.get(name, speed_up)), 1.0) for name in ADJUSTED
        }

    def fastest(self) -> tuple[SpeedSettings, tuple[Plant, ...]]:
        """Return settings to begin with, and the plants with the greatest errors."""
        acceleration = dict.fromkeys(ADJUSTED, min(8e3, self._drive.max_acceleration))
        settings = SpeedSettings(acceleration, self._max_feed, jerk=1e6)
        settings, plants = self._worst_plants(settings)
        best = self._with_best_feeds(self._try(settings, plants), plants)
        for name, ladder in LADDERS.items():
            best = self._with_best(name, ladder, best, plants)
        return self._worst_plants(self._corrected(best))

    def _try(self, settings: SpeedSettings, plants: tuple[Plant, ...]) -> Trial:
        """Return the outcome with these settings, or with gentler ones if they are refused."""
        for _ in range(6):
            trial = self._drive.try_pieces(self._pieces, settings, plants)
            if not trial.refused:
                return trial
            settings = _gentler(settings)
        raise HframeError(trial.refused)

    def _worst_plants(self, settings: SpeedSettings) -> tuple[SpeedSettings, tuple[Plant, ...]]:
        """Return settings corrected on all plants; the model and the two worst for each feature."""
        trial = self._try(settings, self._plants)
        worst = {k for errors in trial.errors.values() for k in np.argsort(errors)[-2:].tolist()}
        plants = (self._plants[0], *(self._plants[k] for k in sorted(worst - {0})))
        return self._corrected(trial), plants

    def _corrected(self, trial: Trial) -> SpeedSettings:
        """Return settings with which each feature should use up its bound."""
        shares = self._bound.shares(trial).items()
        gains = {name: AIM / max(share, 1e-9) for name, share in shares}
        return _accelerated(trial.settings, gains, self._drive.max_acceleration)

    def _with_best_feeds(self, best: Trial, plants: tuple[Plant, ...]) -> Trial:
        """Lower each feature's feed rate in steps of 20 % as long as that makes it quicker.

        Where a plant is slightly off the model, the path is missed at speed, and a slower feature
        may accelerate more.
        """
        first = best
        times, feeds = self._times(best), dict(best.settings.feed)
        improving = set(times)
        for step in range(1, 20):
            shares = self._bound.shares(best)
            least = {name: MIN_FEED if shares.get(name, 0.0) > 1.0 else 1.0 for name in feeds}
            lower = {name: self._max_feed[name] * 0.8**step for name in improving}
            feed = feeds | {name: max(value, least[name]) for name, value in lower.items()}
            if feed == feeds:
                break
            trial = self._try(replace(self._corrected(best), feed=feed), plants)
            now = self._times(trial)
            improving = {n for n in improving if now.get(n, np.inf) < QUICKER * times[n]}
            if not improving:
                break
            best = trial
            feeds |= {name: feed[name] for name in improving}
            times |= {name: now[name] for name in improving}
        if best is first:
            return first
        return self._try(replace(self._corrected(best), feed=feeds), plants)

    def _with_best(
        self, name: str, ladder: tuple[float, ...], best: Trial, plants: tuple[Plant, ...]
    ) -> Trial:
        """Raise a setting as long as the print gets quicker; if it does not, lower it likewise."""
        start = ladder.index(getattr(best.settings, name))
        for values in (ladder[start + 1 :], ladder[:start][::-1]):
            first = best
            for value in values:
                changed: dict[str, Any] = {name: value}
                trial = self._try(replace(self._corrected(best), **changed), plants)
                if not self._time(trial) < QUICKER * self._time(best):
                    break
                best = trial
            if best is not first:
                break
        return best

    def _time(self, trial: Trial) -> float:
        """Estimate the seconds of the trial with each feature using up its bound."""
        measured = sum(self._seconds(trial, name).sum() for name in trial.errors)
        return trial.seconds - float(measured) + sum(self._times(trial).values())

    def _times(self, trial: Trial) -> dict[str, float]:
        """Estimate the seconds of each feature if it used up its bound.

        The time of speed changes falls with the root of the acceleration, which the motors limit.
        A feature whose error is too great must be slower as a whole.
        """
        changing_causes = [CAUSES.index(cause) for cause in ("motors", "error")]
        times, used = dict[str, float](), trial.settings.acceleration
        for name, share in self._bound.shares(trial).items():
            seconds = self._seconds(trial, name)
            changing = float(seconds[changing_causes].sum())
            least = max(0.3, used[name] / self._drive.max_acceleration)
            log_gain = float(np.log(np.clip(share, least, 1.0)))
            times[name] = float(seconds.sum()) * max(share, 1.0) + 0.5 * changing * log_gain
        return times

    @staticmethod
    def _seconds(trial: Trial, name: str) -> Array:
        """Return the seconds of a feature by cause, (CAUSES,)."""
        return np.asarray(trial.limited[NAMES.index(name)])
