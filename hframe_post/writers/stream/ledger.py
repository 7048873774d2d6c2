"""What has been written, counted: filament, and lines of motion a second."""

from __future__ import annotations

import numpy as np

from hframe_post.arrays import TS, Integers

PER_SECOND = round(1.0 / TS)
PER_MM = 1e5  # steps of filament
COUNTED = 5_000_000  # steps after which some firmware must count anew


class Ledger:
    """Filament in steps of 0.00001 mm, and mm in lines passed on; lines of motion a second."""

    def __init__(self, steps: int = 0) -> None:
        self._begun, self._steps, self._passed, self.busiest = steps, steps, 0.0, 0
        self._counted = steps  # when the firmware last began to count
        self._second, self._lines = 0, 0  # lines in that second, so far

    def moved(self, samples: Integers, steps: int) -> None:
        """Lines that extrude so much in all, and the samples, ascending, at which they are due."""
        self._steps += steps
        seconds = samples // PER_SECOND
        first = np.append(0, np.flatnonzero(np.diff(seconds)) + 1)  # row of each second
        counts = np.diff(np.append(first, len(seconds)))
        for second, count in zip(seconds[first].tolist(), counts.tolist(), strict=True):
            self._lines = count + (self._lines if second == self._second else 0)
            self._second, self.busiest = second, max(self.busiest, self._lines)

    def passed(self, filament: float) -> None:
        """A line of the file that extrudes so many mm."""
        self._passed += filament

    def counts_anew(self) -> bool:
        """Whether so much was written since the last time that firmware should count from 0."""
        anew = abs(self._steps - self._counted) > COUNTED
        if anew:
            self._counted = self._steps
        return anew

    @property
    def filament(self) -> float:
        """All of it since the print began, mm."""
        return self._steps / PER_MM + self._passed

    @property
    def written(self) -> float:
        """What has been counted here, mm."""
        return (self._steps - self._begun) / PER_MM + self._passed
