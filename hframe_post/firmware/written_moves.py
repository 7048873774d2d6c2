"""How a firmware plays moves of one axis as they are written, with limits that the file sets."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hframe_post.arrays import Array, Integers
from hframe_post.firmware.code import Code


class Ramps(NamedTuple):
    """Speeds at both ends of moves, mm/s, and the seconds that they take, each (k,)."""

    v_s: Array
    v_e: Array
    seconds: Array


@dataclass(frozen=True, slots=True)
class WrittenMoves:
    """Moves as a firmware plays them that is exact: no whole steps, ramps of constant acceleration.

    step: mm of which places are multiples; least: steps of the shortest move; begin: lines before
    the first of these moves; after_cancel: what to do where a file of them is cancelled.
    """

    code: Code

    @property
    def step(self) -> float:
        return 0.001

    @property
    def least(self) -> int:
        return 10

    @property
    def reversal(self) -> float:
        """Return the speed, mm/s, of two short moves between which an axis turns back; 0: none.

        At that speed it turns, sets out and arrives at once.
        """
        return 0.0

    @property
    def begin(self) -> list[str]:
        return []

    @property
    def after_cancel(self) -> str:
        return "restart the firmware: until then it keeps this file's limits."

    def limits(self, fastest: float, acceleration: float) -> list[str]:
        """Return lines that set limits, mm and s, with which to turn back is to stop.

        But for a turn at the speed of ``reversal``.
        """
        return self.code.set_limits(fastest, acceleration, 0.0)

    def speed(self, v: float) -> float:
        """Return the feed rate, mm/s, that the firmware turns into the speed v."""
        return v

    def ramps(self, cells: Integers, v: Array, turns: Array, acceleration: float) -> Ramps:
        """Return the ramps of moves between places (k + 1, 2), in steps of x and y.

        v (k,): their feed rates; turns (k + 1,): most speed at their ends; acceleration: mm/s².
        """
        a, v_s, v_e = acceleration, turns[:-1], turns[1:]
        d = np.abs(np.diff(cells, axis=0)).sum(axis=1) * self.step
        top = np.minimum(v, np.sqrt(a * d + (v_s**2 + v_e**2) / 2.0))
        ramps = ((top - v_s) ** 2 + (top - v_e) ** 2) / (2.0 * a)
        return Ramps(v_s, v_e, (d + ramps) / top)
