"""The search on an excerpt: the settings with which a whole print within a bound begins."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hframe_post.errors import HframeError
from hframe_post.model.plant import Plant
from hframe_post.planner.pacing import ADJUSTED
from hframe_post.studies.inputs import Piece
from hframe_post.studies.speed.drive import Drive
from hframe_post.studies.speed.steps import Bound, Searches, gentler
from hframe_post.studies.speed.trial import SpeedSettings, TrialPrint

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

    def error_at(self, acceleration: float) -> float:
        """Return the greatest error (mm) of any feature with this acceleration, mm/s²."""
        trial = self.tried(self._settings(acceleration), self._plants)
        return max((max(errors) for errors in trial.errors.values()), default=0.0)

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
