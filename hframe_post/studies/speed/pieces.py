"""The fastest way to drive a print, sought on pieces of it: limits, feeds, printers that decide."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from hframe_post.arrays import Array
from hframe_post.errors import HframeError
from hframe_post.model.plant import Plant
from hframe_post.planner.pacing import NAMES
from hframe_post.studies.speed.bound import (
    AIM,
    JERK,
    LADDERS,
    SLOWEST,
    START,
    STRIDE,
    TINY,
    Bound,
    gentler,
    harder,
)
from hframe_post.studies.speed.drive import Drive
from hframe_post.studies.speed.trial import CAUSES, DRIVEN, Driven, Trial

GENTLER = 6  # times that what cannot be driven so is driven less hard
DECIDE = 2  # drawn printers that are judged for each kind, the worst for it
RUNG, MOST_RUNGS = 0.8, 20  # of feeds, from the greatest to the file's
CHANGING = [CAUSES.index(cause) for cause in ("motors", "error")]  # held by the acceleration
QUICKER = 0.995  # share of the time from which a rung of a ladder is worth it


class Pieces:
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
        for _ in range(GENTLER):
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
