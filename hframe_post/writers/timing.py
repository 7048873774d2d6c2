"""The feed rates and dwells that keep the machine in time."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hframe_post.arrays import TS, Array, E, Flags, Integers
from hframe_post.firmware.motion import MotionRules, NextTo, Stroke, Way
from hframe_post.writers.decimation import Units
from hframe_post.writers.page import Asked, Between, Page, PlacedMove

CATCH_UP = 0.01  # share of its time by which a segment is sped up or delayed, in a long motion
REVERSED = -0.999  # cosine between ways from which every firmware stops between them
EARLY = 0.3  # share of its time by which a segment is shorter for one after it that needs longer
LEAST = 0.1  # share of its time that a segment is asked to take at least, to make up for others


class Motion(NamedTuple):
    """Segments (k,) in which something moves.

    at (k + 1, 4): places, in output units; T (k,): seconds that each is to last; dwell (k,):
    samples of dwell before each; due (k,): the sample at which each ends; between: other lines.
    stops: whether the machine rests after the last; after: greatest speed, mm/s, at its end.
    """

    at: Integers
    T: Array
    dwell: Integers
    due: Integers
    between: Between
    stops: bool = False
    after: float = math.inf


@dataclass(slots=True)
class _Lift:
    """A lift that waits for the speed of the next motion.

    asked: its row; way: of the lift; seconds: that it should last; entry: speed, mm/s, from which
    it begins; stroke: into the greatest speed.
    """

    asked: Asked | None

    move: PlacedMove
    way: Way
    seconds: float
    entry: float
    stroke: Stroke


class Timing:
    """Feed rates and dwells of one machine, whose lines go to a page.

    steady: segments over which time is kept inside a motion, too; 0: over a batch. It takes an F
    with many digits. ``lag``: seconds by which the machine is late, as far as rounding tells; the
    next motion makes up for it. ``lost``: those that none made up for.
    """

    def __init__(self, rules: MotionRules, units: Units, steady: int = 0) -> None:
        self.page = Page(units)
        self._rules, self._units, self._steady = rules, units, steady or rules.steady
        self._per_feed = units.per_feed
        self._before = 0.0  # speed of the last segment, mm/s, or left by a stroke; 0: it rests
        self.lag = self.lost = 0.0
        self._fresh = True  # nothing has moved since the machine was taken over
        # last segment of a batch, as ``MotionRules.durations`` takes it
        self._ending: tuple[Array, Array, Flags, float] | None = None
        self._lift: _Lift | None = None

    @property
    def waits(self) -> bool:
        """Return whether a line of the page depends on what follows."""
        return self._lift is not None

    def change_limits(self, lines: bytes) -> None:
        """Write lines that change feed rate and limits: lateness does not matter any more."""
        self.page.add_limits(lines)
        self.lost += self.lag
        self.lag, self._fresh = 0.0, True

    def motion(self, motion: Motion) -> None:
        """Write segments."""
        at, dwells = motion.at / self._units.per_mm, motion.dwell.nonzero()[0].tolist()
        rest = np.zeros(len(at), bool)
        if dwells:
            rest[dwells] = True
        rest[-1] = motion.stops
        before = 0.0
        if self._lift is not None:
            # as far as is known yet: the motion makes up for what the lift then takes longer
            before = 0.0 if motion.dwell[0] else self._lift.stroke.left
            self._pass_into(self._first_entry(at, float(motion.T[0]), before))
        feeds = self.feeds(at, motion.T, rest, motion.after)
        if self._lift is not None:
            v = float(feeds[0] / self._per_feed)
            self._leave(self._rules.entry(at[:2], v, before))
        waits = [(row, self._dwell(int(motion.dwell[row]))) for row in dwells]
        self.page.add_motion(motion.at, feeds, motion.due, motion.between, waits)

    def _first_entry(self, at: Array, T: float, before: float) -> float:
        """Return the speed, mm/s, at which a first segment that is to last T begins.

        It is inf where the segment takes the speed of the lift before it.
        """
        if self._lift is not None and self._lift.stroke.fastest < math.inf:
            return math.inf
        return self._rules.entry(at[:2], _first_length(at) / T, before)

    def feeds(self, at: Array, T: Array, rest: Flags, after: float) -> Integers:
        """Return F (k,) of segments between places at (k + 1, 4), mm, that are to last T (k,).

        rest (k + 1,): whether the machine rests at each end, noted here for the first; after:
        greatest speed at the last.
        """
        if self._turns_back(at):
            self._end_batch_at(0.0)
            self._before = 0.0
        rest[0] |= self._before == 0.0
        planned, T = T, self._possible(at, T)
        if self._lift is not None and self._lift.stroke.fastest < math.inf:
            T[0] = self._lift.stroke.time_of_next(_first_length(at), float(T[0]))
        if self._fresh:
            T = T + self._rules.head_start(at)
        late, passed = abs(self.lag), T.cumsum()
        share = min(CATCH_UP, late / min(float(passed[-1]), 1.0))  # over 1 s, if there is one
        made_up = np.minimum(share * passed, late)
        made_up[1:] -= made_up[:-1]
        wanted = T - made_up if self.lag > 0.0 else T + made_up
        feeds, taken = self._asked(at, wanted, rest, after)
        if self._steady:
            drift = _near(taken - wanted, self._steady) / _near(T, self._steady)
            asked = np.maximum(wanted - drift * T, LEAST * T)
            feeds, taken = self._asked(at, asked, rest, after)
        self._join(at, feeds, rest)
        over = taken - (T if self._fresh else planned)
        if self._fresh:  # a crawl before all motion, whose F is coarse: none need make up for it
            over[0], self._fresh = 0.0, False
        self.lag += float(over.sum())
        self._before = min(float(feeds[-1] / self._per_feed), after)
        return feeds

    def _possible(self, at: Array, planned: Array) -> Array:
        """Return times (k,) that segments can last, beginning early where they need longer."""
        possible = self._rules.possible_times(at, planned, self._before)
        if possible is planned or not (possible > planned).any():
            return possible
        return self._rules.possible_times(at, _begun_early(planned, possible), self._before)

    def _asked(self, at: Array, T: Array, rest: Flags, after: float) -> tuple[Integers, Array]:
        """Return F by which segments are to last T (k,), and how long they then take."""
        return self._rules.feeds(at, T, rest, self._before, after, self._per_feed)

    def _turns_back(self, at: Array) -> bool:
        """Return whether a batch goes back along the last segment of the one before it."""
        if self._ending is None or self._before == 0.0:
            return False
        steps = (np.subtract(to, start) for start, to in (self._ending[0], at[:2]))
        last, way = (step[:E].tolist() for step in steps)
        cosine = sum(a * b for a, b in zip(last, way, strict=True))
        return bool(cosine < REVERSED * math.hypot(*last) * math.hypot(*way))

    def _end_batch_at(self, speed: float) -> None:
        """Add what the last segment of a batch takes longer to end at a speed, mm/s."""
        assert self._ending is not None
        seconds, planned = (
            float(self._rules.durations(*self._ending, end)[0]) for end in (speed, self._before)
        )
        self.lag += seconds - planned

    def _join(self, at: Array, feeds: Integers, rest: Flags) -> None:
        """Let the last segment of a batch slow down for this batch, whose own last one may, too."""
        v = feeds[-2:] / self._per_feed
        if self._ending is not None and not rest[0]:
            self._end_batch_at(min(self._before, float(feeds[0] / self._per_feed)))
        alone = len(v) == 1
        entry = self._before if alone else float(v[0])
        self._ending = at[-2:], v[-1:], np.array([alone and rest[0], False]), entry

    def stroke(self, move: PlacedMove) -> None:
        """Write a retraction or a lift."""
        dwell, next_to = move.dwell, NextTo.LIFT if move.lifts else NextTo.RETRACTION
        way, previous = self._way(move), self._lift.way if self._lift else None
        into, out = self._rules.corners(way, move.speed, (dwell.entry, dwell.leaving), previous)
        self._before = min(self._before, into)
        self._leave(self._before)
        if self._before == 0.0:
            self.page.add_lines(self._dwell(0, next_to) or b"")
        planned, entry = dwell.samples * TS, self._before
        seconds = planned - self.lag
        stroke = self._rules.stroke(way, move.speed, dwell.exact, seconds, entry, out)
        self.lag += stroke.seconds - planned
        self._before, self._ending = stroke.left, None
        asked = self.page.add_stroke(move)
        if out:
            self._lift = _Lift(asked, move, way, seconds, entry, stroke)
            return
        if asked is not None:
            self.page.ask(asked, stroke)
        self.page.add_lines(self._dwell(0, next_to) or b"")

    def _way(self, move: PlacedMove) -> Way:
        return Way(self._units.mm(move.start), self._units.mm(move.end), move.acceleration)

    def _leave(self, speed: float) -> None:
        """Let the lift that waits for the next motion pass into it at a speed, mm/s."""
        if self._lift is None:
            return
        self._pass_into(speed)
        lift, self._lift = self._lift, None
        if lift.asked is not None:
            self.page.ask(lift.asked, lift.stroke)

    def _pass_into(self, speed: float) -> None:
        """Plan the lift that waits for motion once more, to leave at its speed, mm/s."""
        lift = self._lift
        assert lift is not None
        if speed != lift.stroke.left:
            seconds, exact = lift.stroke.seconds, lift.move.dwell.exact
            lift.stroke = self._rules.stroke(
                lift.way, lift.move.speed, exact, lift.seconds, lift.entry, speed
            )
            self.lag += lift.stroke.seconds - seconds

    def stop(self, samples: int = 0) -> None:
        """Come to rest, and dwell for this many samples more."""
        self._leave(0.0)
        line = self._dwell(samples) if samples else None
        self.page.add_lines(line or b"")
        if line != b"":  # else the firmware leaves the dwell out
            self._before = 0.0

    def _dwell(self, samples: int, next_to: NextTo = NextTo.MOTION) -> bytes | None:
        """Return the line for a dwell, less what the machine is late; None: it needs none.

        It is empty where the firmware leaves the dwell out.
        """
        dwell = self._rules.dwell(samples * TS - self.lag, next_to)
        if dwell is None:
            return None
        line, waited = dwell
        self.lag += waited - samples * TS
        return line


def _first_length(at: Array) -> float:
    """Return the length of the first segment, mm, to the bit of ``lengths``."""
    x, y, z, _ = (at[1] - at[0]).tolist()
    return math.sqrt(x * x + y * y + z * z)


def _begun_early(planned: Array, possible: Array) -> Array:
    """Return times (k,) in which the segments before one that needs longer than planned give way.

    Before a motor sets out after a turn the machine is slow: being early matters less than late.
    """
    over = (possible - planned)[::-1]
    change = np.where(over > 0.0, over, -EARLY * planned[::-1])
    total = np.cumsum(change)
    early = total - np.minimum(np.minimum.accumulate(total), 0.0)
    return np.asarray(planned + np.diff(early, prepend=0.0)[::-1])


def _near(x: Array, n: int) -> Array:
    """Return the sum of x (k,) over n neighbours of each, or as many as there are."""
    n = min(n, len(x))
    total = np.cumsum(np.append(0.0, x))  # np.convolve would sum in an order that depends on BLAS
    first = np.arange(-(n // 2), len(x) - n // 2)
    return np.asarray(total[np.minimum(first + n, len(x))] - total[np.maximum(first, 0)])
