"""The states of a stop, and how long the path rests in each of them.

           STOP            DWELL, ENTER             MOVE
    MOVING ────► STOPPED ─────────────► SETTLED ─────────► MOVING
                    │  ◄───────────────    │
                    │        LEAVE         │
                    └────PART──► APART ◄───┘ ────MOVE────► MOVING

ENTER and LEAVE are the corners between motion and a lift, which firmware may take at a speed.
A command settles after the path has come to rest, and leads the path when it sets out. Samples of
rest give it time for both. What parts two motions needs more of it.
"""

from __future__ import annotations

from collections.abc import Callable
from enum import Enum, auto

from hframe_post.stream.types import StopRules


class State(Enum):
    """Whether path and command are at rest."""

    MOVING = auto()
    STOPPED = auto()  # the path is at rest; the command has had no time to settle
    SETTLED = auto()  # so is the command, which needs time again before it sets out
    APART = auto()  # the same; what follows has nothing to do with the motion before


class Change(Enum):
    """What happens to the path."""

    MOVE = auto()  # it sets out
    STOP = auto()  # it comes to rest
    DWELL = auto()  # the command must dwell
    PART = auto()  # the same for long, or while the machine is released
    ENTER = auto()  # motion passes into a lift
    LEAVE = auto()  # a lift passes into motion


def _none(_: StopRules) -> int:
    return 0


def _before(rules: StopRules) -> int:
    return rules.before


def _after(rules: StopRules) -> int:
    return rules.after


def _long(rules: StopRules) -> int:
    return rules.long_rest


# every change that can happen → how many samples the path rests first, and the state after it
CHANGES: dict[tuple[State, Change], tuple[Callable[[StopRules], int], State]] = {
    (State.MOVING, Change.MOVE): (_none, State.MOVING),
    (State.MOVING, Change.STOP): (_none, State.STOPPED),
    (State.STOPPED, Change.MOVE): (_none, State.MOVING),
    (State.STOPPED, Change.DWELL): (_before, State.SETTLED),
    (State.STOPPED, Change.PART): (_long, State.APART),
    (State.STOPPED, Change.ENTER): (_none, State.SETTLED),
    (State.SETTLED, Change.MOVE): (_after, State.MOVING),
    (State.SETTLED, Change.DWELL): (_none, State.SETTLED),
    (State.SETTLED, Change.PART): (_none, State.APART),
    (State.SETTLED, Change.LEAVE): (_none, State.STOPPED),
    (State.APART, Change.MOVE): (_long, State.MOVING),
    (State.APART, Change.DWELL): (_none, State.APART),
    (State.APART, Change.PART): (_none, State.APART),
}


class Stopping:
    """The present state, by the rules of a firmware and a strategy."""

    def __init__(self, rules: StopRules) -> None:
        self._rules, self.state = rules, State.APART

    @property
    def settled(self) -> bool:
        return self.state in (State.SETTLED, State.APART)

    def change(self, change: Change) -> int:
        """Change the state; return for how many samples the path must rest before."""
        samples, self.state = CHANGES[self.state, change]
        return samples(self._rules)
