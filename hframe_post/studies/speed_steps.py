"""Steps of a search: the next acceleration and feed rate of each feature, by the trials so far.

The error grows with the acceleration of the path, and it is local: each kind of feature has its own
search for the acceleration at which it uses up its bound, and each trial is a step of them all.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from hframe_post.errors import HframeError
from hframe_post.model.plant import Plant
from hframe_post.planner.pacing import ADJUSTED, NAMES
from hframe_post.studies.inputs import Piece
from hframe_post.studies.speed_drive import Drive
from hframe_post.studies.speed_trial import (
    CAUSES,
    Measure,
    SpeedSettings,
    TrialPrint,
)

NEAR, LIMIT = 0.87, 0.95  # share of a bound to use up: other printers may have a greater error
AIM = math.sqrt(NEAR * LIMIT)
FEED_STEP = 0.8  # factor from one feed rate that is tried to the next
MIN_FEED = 0.3  # times the file's feed rates
MIN_ACCELERATION = 200.0  # mm/s²


@dataclass(frozen=True, slots=True)
class Bound:
    """Greatest errors (mm): by kind of feature, and of all others. width: of lines, as a share."""

    others: float
    kinds: dict[str, float] = field(default_factory=dict)
    measure: Measure = "p95"
    width: float = math.inf

    def limit(self, name: str) -> float:
        return self.kinds.get(name, self.others)

    def shares(self, trial: TrialPrint) -> dict[str, float]:
        """Return the share of its bound that each feature uses up on its worst plant."""
        shares = {name: max(errors) / self.limit(name) for name, errors in trial.errors.items()}
        for name, widths in trial.widths.items():
            shares[name] = max(shares[name], max(widths) / self.width)
        return shares


class Searches:
    """The searches of all kinds of features. trials: their steps so far."""

    def __init__(
        self, bound: Bound, max_acceleration: float, trials: Iterable[TrialPrint] = ()
    ) -> None:
        self._bound, self._max_acceleration = bound, max_acceleration
        self.trials = list(trials)

    def corrected(self, feed: dict[str, float]) -> SpeedSettings:
        """Return the last settings with accelerations at which features use up their bounds.

        Features of unknown error get the least acceleration of the others.
        """
        last, known = self.trials[-1], dict[str, float]()
        for name in last.errors:
            same_feed = [t for t in self.trials if t.settings.feed[name] == feed[name]]
            points = [self._point(t, name) for t in same_feed or [last] if name in t.errors]
            found = math.exp(_root(points or [self._point(last, name)]))
            known[name] = min(max(found, MIN_ACCELERATION), self._max_acceleration)
        least = min(known.values(), default=8e3)
        acceleration = {name: known.get(name, least) for name in feed}
        return replace(last.settings, acceleration=acceleration, feed=feed)

    def _point(self, trial: TrialPrint, name: str) -> tuple[float, float]:
        """Return the logarithms of acceleration and of error; the latter is 0 at the aim."""
        share = self._bound.shares(trial)[name]
        return math.log(trial.settings.acceleration[name]), math.log(max(share, 1e-9) / AIM)

    def best_feeds(self) -> dict[str, float]:
        """Return the feed rate at which each feature takes the least time within its bound."""
        return {name: min(times, key=lambda f: times[f]) for name, times in self._times().items()}

    def next_feeds(self) -> dict[str, float]:
        """Return each feature's best feed rate, or a lower one if not two lower ones were tried.

        Where a plant is slightly off the model, the path is missed at speed, and a slower feature
        may accelerate more, unless it already accelerates as the motors do.
        """
        feeds = self.best_feeds()
        for name, times in self._times().items():
            if min(times) > FEED_STEP**1.5 * feeds[name] and not self._free(name, feeds[name]):
                feeds[name] = max(FEED_STEP * min(times), MIN_FEED)
        return feeds

    def _free(self, name: str, feed: float) -> bool:
        """Return whether a feature is within its bound at this feed and the motors' limit."""
        return any(
            trial.settings.feed[name] == feed
            and trial.settings.acceleration[name] >= self._max_acceleration
            and self._bound.shares(trial).get(name, 1.0) < 1.0
            for trial in self.trials
        )

    def _times(self) -> dict[str, dict[float, float]]:
        """Estimate the seconds of each feature at each feed rate tried, with its bound used up.

        The time of speed changes falls with the root of the acceleration, which the motors limit.
        A feature whose error is too great must be slower as a whole.
        """
        changing = [CAUSES.index(cause) for cause in ("motors", "error")]
        times: dict[str, dict[float, float]] = {name: {} for name in ADJUSTED}
        for trial in self.trials:
            shares, used = self._bound.shares(trial), trial.settings.acceleration
            for name, feed in trial.settings.feed.items():
                seconds = trial.limited[NAMES.index(name)]
                share = shares.get(name, AIM) / AIM
                gain = math.log(min(max(share, used[name] / self._max_acceleration), 1.0))
                times[name][feed] = float(
                    seconds.sum() * max(share, 1.0) + 0.5 * gain * seconds[changing].sum()
                )
        return times


def _root(points: list[tuple[float, float]]) -> float:
    """Return where y, which rises with x, is 0 by these points; y = x + c for one.

    A point that is near enough is returned itself. Between points on both sides it is on the line
    through the nearest two. Beyond points on one side it lies beyond them all, so that each step
    leads on even where y hardly rises. Of two points with the same x the later one counts: y also
    depends on what else changed.
    """
    points = list(dict(points).items())
    nearest = min(points, key=lambda point: abs(point[1]))
    if math.log(NEAR / AIM) <= nearest[1] <= math.log(LIMIT / AIM):
        return nearest[0]
    above = sorted((point for point in points if point[1] > 0.0), key=lambda point: point[0])
    below = sorted((point for point in points if point[1] <= 0.0), key=lambda point: -point[0])
    if above and below and below[0][0] < above[0][0]:
        (u, v), (x, y) = below[0], above[0]
        return x - (x - u) * y / (y - v)
    (x, y), *others = above or below  # if neither is true of all, the limit counts
    slopes = [(y - v) / (x - u) for u, v in others if abs(x - u) > 0.01]
    slope = min(max(slopes[0], 0.4), 1.5) if slopes else 1.0
    return x - min(max(y / slope, -1.2), 1.2)


def gentler(settings: SpeedSettings) -> SpeedSettings:
    """Return settings with accelerations that are lower by 15 %."""
    acceleration = {name: 0.85 * value for name, value in settings.acceleration.items()}
    return replace(settings, acceleration=acceleration)


# ----------------------------------------------------------------------
# The search on an excerpt: the settings with which a whole print within a bound begins.

START = 8e3  # mm/s² of the first trial
MAX_FEEDS = 8  # how many feed rates are tried

Plants = tuple[Plant, ...]


class ExcerptSearch:
    """Search on pieces of a print, for any bound.

    near: the printer's plant, and others on which bounds must hold. Raises HframeError if the
    pieces cannot be printed.
    """

    def __init__(self, drive: Drive, pieces: Sequence[Piece], near: Plants) -> None:
        self._drive, self.pieces, self._near = drive, pieces, near
        useful, most = drive.useful_feeds(pieces), drive.speed_up
        self._feed = {name: max(min(most, useful.get(name, most)), 1.0) for name in ADJUSTED}
        self._first, self._plants = self._worst(self._settings(START), near)

    def fastest(self, bound: Bound) -> tuple[SpeedSettings, Plants]:
        """Return settings that use up a bound, and the plants with the greatest errors."""
        searches = Searches(bound, self._drive.max_acceleration, [self._first])
        feed = self._feed
        for _ in range(MAX_FEEDS):
            searches.trials.append(self.tried(searches.corrected(feed), self._plants))
            before, feed = feed, searches.next_feeds()
            if feed == before:
                break
        feed = searches.best_feeds()
        last, plants = self._worst(searches.corrected(feed), self._near)
        searches.trials.append(last)
        return searches.corrected(feed), plants

    def _settings(self, acceleration: float) -> SpeedSettings:
        """Return settings with this acceleration, and feed rates as high as is of use."""
        acceleration = min(acceleration, self._drive.max_acceleration)
        return SpeedSettings(dict.fromkeys(ADJUSTED, acceleration), self._feed)

    def _worst(self, settings: SpeedSettings, plants: Plants) -> tuple[TrialPrint, Plants]:
        """Return a trial, and those of these plants with the greatest errors."""
        trial = self.tried(settings, plants)
        worst = (np.argsort(errors)[-2:].tolist() for errors in trial.errors.values())
        return trial, tuple(plants[k] for k in sorted({0}.union(*worst)))

    def tried(self, settings: SpeedSettings, plants: Plants) -> TrialPrint:
        """Return a trial of the pieces, with gentler settings if these are refused."""
        for _ in range(6):
            trial = self._drive.try_pieces(self.pieces, settings, plants)
            if not trial.refused:
                return trial
            settings = gentler(settings)
        raise HframeError(trial.refused)
