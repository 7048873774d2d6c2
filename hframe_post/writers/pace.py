"""Time: the feed rates and dwells that keep the machine to it, and what it lags behind."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from hframe_post.arrays import TS, Array, Flags, Integers
from hframe_post.firmware.player import Dwelling, Player, Stroke
from hframe_post.stream.types import Pause

CATCH_UP = 0.01  # share of a batch's time by which it may be hurried or delayed


class Pace:
    """Feed rates and dwells of one machine.

    per_feed: units of F in a mm/s. ``lag``: s by which the machine is late, as far as rounding
    tells; the next motion makes up for it.
    """

    def __init__(self, player: Player, per_feed: float) -> None:
        self._player, self._per_feed = player, per_feed
        self._before = 0.0  # speed of the last segment, mm/s, or left by a stroke; 0: it stands
        self._passing: Callable[[float], Stroke] | None = None  # the last, by the speed it leaves
        self.lag = 0.0
        self._fresh = True  # nothing has moved since the machine was taken over

    def begin(self) -> None:
        """The machine is taken over: what it is late by does not matter any more."""
        self.lag, self._fresh = 0.0, True

    def feeds(self, at: Array, T: Array, rest: Flags, after: float) -> Integers:
        """F (k,) of segments between places at (k + 1, 4), mm, that are to last T (k,).

        rest (k + 1,): whether the machine stands at each end; after: greatest speed at the last.
        """
        rest = rest.copy()
        rest[0] |= self.stands
        T = self._player.possible_times(at, T, self._before)
        hurried = T * (1.0 - np.clip(self.lag / T.sum(), -CATCH_UP, CATCH_UP))
        v = self._player.feed_rates(at, hurried, rest, self._before, after)
        feeds = np.maximum(np.rint(v * self._per_feed), 1.0).astype(np.int64)
        v = feeds / self._per_feed
        taken = self._player.durations(at, v, rest, self._before, after)
        self._pass_into(float(v[0]))
        late = taken - T
        if self._fresh:  # a crawl before all motion, whose F is coarse: none need make up for it
            late[0], self._fresh = 0.0, False
        self.lag += float(late.sum())
        self._before = min(float(v[-1]), after)
        return feeds

    @property
    def stands(self) -> bool:
        """Whether the machine does, as far as was asked of it."""
        return self._before == 0.0

    def moves(self, speed: float) -> None:
        """The machine has begun to move."""
        self._before = speed

    def stop(self) -> None:
        """The machine stands."""
        self._before = 0.0

    def stroke(self, at: Array, pause: Pause, speed: float, stops: bool) -> Stroke:
        """The retraction or lift of a pause between places at (2, 4), mm, at the user's speed.

        stops: whether the machine stands after it, whatever was planned.
        """
        planned, entry = pause.samples * TS, min(pause.entry, self._before)
        wanted = planned - self.lag

        def leaving(exit_speed: float) -> Stroke:
            return self._player.stroke(at, speed, pause.exact, wanted, entry, exit_speed)

        stroke = leaving(0.0 if stops else pause.leaving)
        self._passing = leaving if pause.leaving and not stops else None
        self.lag += stroke.seconds - planned
        self._before = stroke.left
        return stroke

    def _pass_into(self, speed: float) -> None:
        """Motion at that speed follows a lift, which may have to leave slower for its sake."""
        if self._passing is not None and speed < self._before:
            self.lag += self._passing(speed).seconds - self._passing(self._before).seconds
        self._passing = None

    def dwell(self, samples: int, beside: Dwelling = Dwelling.MOTION) -> bytes:
        """Standstill for so long, less what the machine is late; empty where none is made."""
        waiting = self._player.dwell(samples * TS - self.lag, beside)
        if waiting is None:
            return b""
        line, waited = waiting
        self.lag += waited - samples * TS
        return line
