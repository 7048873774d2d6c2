"""Time: the feed rates and dwells that keep the machine to it, and what it lags behind."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from hframe_post.arrays import TS, Array, Flags, Integers
from hframe_post.firmware.player import Dwelling, Player, Stroke
from hframe_post.stream.types import Pause

SOON = 1.0  # s, over which what is late is made up for, where motion lasts so long
CATCH_UP = 0.01  # share of its time by which a segment is hurried or delayed


class Pace:
    """Feed rates and dwells of one machine.

    per_feed: units of F in a mm/s. steady: segments over which time is kept inside a motion, too;
    0: over a batch. It takes an F of many digits. ``lag``: s by which the machine is late, as far
    as rounding tells; the next motion makes up for it.
    """

    def __init__(self, player: Player, per_feed: float, steady: int = 0) -> None:
        self._player, self._per_feed, self._steady = player, per_feed, steady
        self._before = 0.0  # speed of the last segment, mm/s, or left by a stroke; 0: it stands
        # a lift by the speed that it leaves, and what was believed of it
        self._leaving: tuple[Callable[[float], Stroke], Stroke] | None = None
        self.lag = 0.0
        self._fresh = True  # nothing has moved since the machine was taken over
        # s that the last segment takes, by the speed at its end: that of the one that follows
        self._ending: Callable[[float], float] | None = None

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
        late, passed = abs(self.lag), np.cumsum(T)
        share = min(CATCH_UP, late / min(float(passed[-1]), SOON))
        made_up = np.minimum(share * passed, late)
        hurried = T - np.copysign(np.diff(made_up, prepend=0.0), self.lag)
        feeds, taken = self._asked(at, hurried, rest, after)
        if self._steady:
            near = np.ones(min(self._steady, len(T)))
            drift = np.convolve(taken - hurried, near, "same") / np.convolve(T, near, "same")
            feeds, taken = self._asked(at, hurried - drift * T, rest, after)
            self._join(at, feeds, rest, after)
        over = taken - T
        if self._fresh:  # a crawl before all motion, whose F is coarse: none need make up for it
            over[0], self._fresh = 0.0, False
        self.lag += float(over.sum())
        self._before = min(float(feeds[-1] / self._per_feed), after)
        return feeds

    def _join(self, at: Array, feeds: Integers, rest: Flags, after: float) -> None:
        """What ended a batch slows down to the speed at which this one begins."""
        v = feeds / self._per_feed
        if self._ending is not None and not rest[0]:
            slower = min(self._before, float(v[0]))
            self.lag += self._ending(slower) - self._ending(self._before)
        entry = float(v[-2]) if len(v) > 1 else self._before
        last = at[-2:], v[-1:], np.array([len(v) == 1 and rest[0], False]), entry
        self._ending = lambda end: float(self._player.durations(*last, end)[0])

    def _asked(self, at: Array, T: Array, rest: Flags, after: float) -> tuple[Integers, Array]:
        """F by which segments are to last T (k,), and how long they then take, (k,) each."""
        v = self._player.feed_rates(at, T, rest, self._before, after)
        feeds = np.maximum(np.rint(v * self._per_feed), 1.0).astype(np.int64)
        v = feeds / self._per_feed
        return feeds, self._player.durations(at, v, rest, self._before, after)

    @property
    def stands(self) -> bool:
        """Whether the machine does, as far as was asked of it."""
        return self._before == 0.0

    def moves(self, speed: float) -> None:
        """The machine has begun to move."""
        self._before, self._ending = speed, None

    def stop(self) -> None:
        """The machine stands."""
        self._before = 0.0

    def stroke(self, at: Array, pause: Pause, speed: float) -> Stroke:
        """The retraction or lift of a pause between places at (2, 4), mm, at the user's speed.

        One that passes into motion is told again by ``leave``.
        """
        planned, entry = pause.samples * TS, self._before if pause.entry else 0.0
        wanted = planned - self.lag
        corner = self._player.lift_corner(at, speed) if pause.leaving else 0.0

        def leaving(v: float) -> Stroke:
            return self._player.stroke(at, speed, pause.exact, wanted, entry, v)

        stroke = leaving(corner)
        self._leaving = (leaving, stroke) if pause.leaving else None
        self.lag += stroke.seconds - planned
        self._before, self._ending = stroke.left, None
        return stroke

    def leave(self, speed: float) -> Stroke:
        """The last lift, which passes into motion at ``speed``, or slower."""
        assert self._leaving is not None
        (leaving, believed), self._leaving = self._leaving, None
        stroke = leaving(speed) if speed < believed.left else believed
        self.lag += stroke.seconds - believed.seconds
        return stroke

    def dwell(self, samples: int, beside: Dwelling = Dwelling.MOTION) -> bytes:
        """Standstill for so long, less what the machine is late; empty where none is made."""
        waiting = self._player.dwell(samples * TS - self.lag, beside)
        if waiting is None:
            return b""
        line, waited = waiting
        self.lag += waited - samples * TS
        return line
