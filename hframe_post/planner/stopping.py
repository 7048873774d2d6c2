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


NONE, BEFORE, AFTER, LONG = range(4)  # what the path rests of, as ``StopRules`` has it

# every change that can happen → how long the path rests first, and the state after it
CHANGES = {
    (State.MOVING, Change.MOVE): (NONE, State.MOVING),
    (State.MOVING, Change.STOP): (NONE, State.STOPPED),
    (State.STOPPED, Change.MOVE): (NONE, State.MOVING),
    (State.STOPPED, Change.DWELL): (BEFORE, State.SETTLED),
    (State.STOPPED, Change.PART): (LONG, State.APART),
    (State.STOPPED, Change.ENTER): (NONE, State.SETTLED),
    (State.SETTLED, Change.MOVE): (AFTER, State.MOVING),
    (State.SETTLED, Change.DWELL): (NONE, State.SETTLED),
    (State.SETTLED, Change.PART): (NONE, State.APART),
    (State.SETTLED, Change.LEAVE): (NONE, State.STOPPED),
    (State.APART, Change.MOVE): (LONG, State.MOVING),
    (State.APART, Change.DWELL): (NONE, State.APART),
    (State.APART, Change.PART): (NONE, State.APART),
}


class Stopping:
    """The present state, by the rules of a firmware and a strategy."""

    def __init__(self, rules: StopRules) -> None:
        self._rests = 0, rules.before, rules.after, rules.long_rest
        self.state = State.APART

    @property
    def settled(self) -> bool:
        return self.state in (State.SETTLED, State.APART)

    def change(self, change: Change) -> int:
        """Change the state; return for how many samples the path must rest before."""
        rest, self.state = CHANGES[self.state, change]
        return self._rests[rest]
