"""The states of a stop, and how long the path rests in each of them.

           stop            dwell, enter             move
    MOVING ────► STOPPED ─────────────► SETTLED ─────────► MOVING
                    │  ◄───────────────    │
                    │        leave         │
                    └─dwell apart► APART ◄─┘ ────move────► MOVING

``enter`` and ``leave`` are the corners between motion and a lift, which firmware may take at a
speed. A command settles after the path has come to rest, and leads the path when it sets out.
Samples of rest give it time for both. What parts two motions needs more of it.
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


class Stopping:
    """The present state, by the rules of a firmware and a strategy."""

    def __init__(self, rules: StopRules) -> None:
        self._rules, self.state = rules, State.APART

    @property
    def settled(self) -> bool:
        return self.state in (State.SETTLED, State.APART)

    def move(self) -> int:
        """Set out; return for how many samples the path must rest before."""
        before, self.state = self.state, State.MOVING
        if before is State.APART:
            return self._rules.long_rest
        return self._rules.after if before is State.SETTLED else 0

    def dwell(self, apart: bool) -> int:
        """Let the command dwell; return for how many samples the path must rest before.

        apart: for long, or while the machine is released.
        """
        assert self.state is not State.MOVING
        rules, stopped = self._rules, self.state is State.STOPPED
        rest = rules.long_rest if apart else rules.before
        if self.state is not State.APART:
            self.state = State.APART if apart else State.SETTLED
        return rest if stopped else 0

    def stop(self) -> None:
        self.state = State.STOPPED

    def enter(self) -> None:
        """Pass from motion into a lift."""
        assert self.state is State.STOPPED
        self.state = State.SETTLED

    def leave(self) -> None:
        """Pass from a lift into motion."""
        assert self.state is State.SETTLED
        self.state = State.STOPPED
