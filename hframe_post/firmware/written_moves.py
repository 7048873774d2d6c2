"""How a firmware plays moves of one axis as they are written, with limits that the file sets."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hframe_post.arrays import TS, Array, Integers
from hframe_post.firmware.code import Code


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

    def ahead(self, z: float) -> list[str]:
        """Return lines that make the firmware plan ahead of the first move. z: height, mm."""
        return []

    def speed(self, v: float) -> float:
        """Return the feed rate, mm/s, that the firmware turns into the speed v."""
        return v

    def motion(self, cells: Integers, v: Array, turns: Array, acceleration: float) -> Array:
        """Return the place along one axis (m,), mm every 1 ms, of moves that begin at 0.

        cells (k + 1, 2): their ends, in steps of x and y; v (k,): their feed rates; turns (k + 1,):
        most speed at their ends; acceleration: mm/s².
        """
        d, at = self._along(cells)
        return np.interp(travelled(d, v, turns[:-1], turns[1:], acceleration), *at)

    def _along(self, cells: Integers) -> tuple[Array, tuple[Array, Array]]:
        """Return the lengths (k,) of moves, and path length and place at their ends, mm."""
        way = np.diff(cells, axis=0).sum(axis=1) * self.step
        d = np.abs(way)
        path, place = (np.concatenate([[0.0], np.cumsum(each)]) for each in (d, way))
        return d, (path, place)


def travelled(d: Array, v: Array, v_s: Array, v_e: Array, a: Array | float) -> Array:
    """Return mm of path (m,) every 1 ms, from the start of the first move to the end of the last.

    d, v, v_s, v_e (k,): lengths and speeds of moves, in mm, with ramps of constant acceleration a.
    """
    top = np.minimum(v, np.sqrt(a * d + (v_s**2 + v_e**2) / 2.0))
    up, down = (top - v_s) / a, (top - v_e) / a
    cruise = np.maximum(d - (v_s + top) / 2.0 * up - (v_e + top) / 2.0 * down, 0.0) / top
    ends, path = np.cumsum(up + cruise + down), np.cumsum(d)
    t = np.arange(int(np.ceil(ends[-1] / TS)) + 1) * TS
    k = np.minimum(np.searchsorted(ends, t, side="right"), len(d) - 1)
    tau = np.minimum(t - (ends - up - cruise - down)[k], (up + cruise + down)[k])
    a = np.broadcast_to(a, d.shape)[k]
    rising, falling = np.minimum(tau, up[k]), np.maximum(tau - (up + cruise)[k], 0.0)
    s = v_s[k] * rising + a * rising**2 / 2.0 + top[k] * np.maximum(tau - up[k], 0.0)
    s -= a * falling**2 / 2.0
    return np.asarray((path - d)[k] + np.minimum(s, d[k]))
