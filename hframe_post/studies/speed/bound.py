"""Bounds on the error of each kind of feature, and steps towards them from try to try."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from hframe_post.studies.speed.trial import Driven, Measure, Trial

START, JERK = 8e3, 1e6  # mm/s², mm/s³ tried first
GENTLEST = 200.0  # mm/s²
LADDERS = {  # what is tried beside the accelerations
    "jerk": (1e5, 2e5, 5e5, 1e6, 3e6, 1e7, 5e7),  # mm/s³
    "corner": (2.5, 5.0, 10.0, 20.0, 40.0),  # mm/s at CORNER_AT
    "travel": (1.0, 2.0, 4.0),  # times the gentlest kind's acceleration
}
STRIDE = (0.3, 3.0)  # of one correction
AIM = 0.92  # share that is aimed at
TINY = 1e-9  # share of a bound, at least, to divide by
SLOWEST = 0.3  # times the file's feed, where that leaves the path by too much
OUTRUN = 0.8  # of the hardest acceleration, where a motor would be outrun
MILDER = 0.93  # of all accelerations, where that is so in some places of the whole print


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


def milder(driven: Driven) -> Driven:
    """All a little less hard."""
    return replace(driven, acceleration={k: MILDER * a for k, a in driven.acceleration.items()})


def gentler(driven: Driven) -> Driven:
    """What is driven hardest, less hard, and all else a rung lower."""
    own = driven.acceleration
    hard = OUTRUN * max(own.values())
    rungs: dict[str, Any] = {
        name: ladder[max(ladder.index(getattr(driven, name)) - 1, 0)]
        for name, ladder in LADDERS.items()
    }
    return replace(driven, acceleration={name: min(a, hard) for name, a in own.items()}, **rungs)
