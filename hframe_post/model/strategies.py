"""The strategies by name, from doing nothing to doing all.

A new one is a class with ``feed`` and ``finish`` in a module beside this, and a row here. The
choices of profiles and command line, reports and figures follow.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from hframe_post.arrays import Array
from hframe_post.errors import HframeError
from hframe_post.model.filtered_splines import FilteredSplines
from hframe_post.model.plant import Plant
from hframe_post.model.strategy import Compensator, Strategy


class _Path:
    """The command is the path."""

    def __init__(self, compensator: Compensator, origin: Array) -> None:
        pass

    def feed(self, xy: Array) -> Array:
        return xy

    def finish(self) -> Array:
        return np.zeros((0, 2))


def _nothing(plant: Plant) -> Plant | None:
    return None


def _rigid(plant: Plant) -> Plant | None:
    return replace(plant, Gxtheta=None)


STRATEGIES = {
    strategy.name: strategy
    for strategy in (
        Strategy("none", "no compensation", "#888888", _Path, _nothing),
        Strategy("fbs", "ringing only (fbs)", "#c05020", partial(FilteredSplines, False), _rigid),
        Strategy("racking", "ringing and racking", "#2060a0", partial(FilteredSplines, True)),
    )
}


def strategy(name: str) -> Strategy:
    """The strategy of that name. Raises HframeError."""
    if name not in STRATEGIES:
        raise HframeError(f"no strategy is named {name!r}; there are {', '.join(STRATEGIES)}")
    return STRATEGIES[name]
