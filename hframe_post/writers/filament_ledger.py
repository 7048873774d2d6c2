"""Filament and lines of motion of a stream, counted as they are written."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence

from hframe_post.arrays import TS, Integers


class Ledger:
    """Filament in steps of 0.00001 mm, and mm in lines passed on; lines of motion a second.

    steps: of filament at the beginning.
    """

    def __init__(self, steps: int = 0) -> None:
        self._begun, self._steps, self._passed, self.busiest = steps, steps, 0.0, 0
        self._counted = steps  # when the firmware last began to count
        self._second, self._lines = 0, 0  # lines in that second, so far

    def moved(self, samples: Sequence[int] | Integers, steps: int) -> None:
        """Add lines that extrude these steps in all and are due at these samples, ascending."""
        self._steps += steps
        a_second, done = round(1.0 / TS), 0
        for second in range(int(samples[0]) // a_second, int(samples[-1]) // a_second + 1):
            end = bisect_left(samples, (second + 1) * a_second)
            self._lines = end - done + (self._lines if second == self._second else 0)
            self._second, self.busiest, done = second, max(self.busiest, self._lines), end

    def passed(self, filament: float) -> None:
        self._passed += filament

    def is_count_due(self) -> bool:
        """Return whether the firmware should count from 0, at least every 2 mm of filament.

        Marlin adds up E in floats of 32 bits, whose errors grow with the sum.
        """
        due = abs(self._steps - self._counted) > 200_000
        if due:
            self._counted = self._steps
        return due

    @property
    def filament(self) -> float:
        """Return all filament since the print began, mm."""
        return self._steps / 1e5 + self._passed

    @property
    def written(self) -> float:
        """Return the filament of this stream, mm."""
        return (self._steps - self._begun) / 1e5 + self._passed
