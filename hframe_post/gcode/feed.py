"""The speed that moves ask for: F, and the factor of M220."""

from __future__ import annotations

import math

from hframe_post.gcode.commands import Dialect, Words
from hframe_post.gcode.lexer import Line

DEFAULT_FEED = 25.0  # mm/s, what Klipper moves at before the first F
SLOWEST = 1.0 / 60.0  # mm/s, F1; what is slower would never end
LEAST_FACTOR = 0.01


class Feed:
    """The feed rate in force.

    rate: as the file gives it, mm/s. speed: times the multiplier, the factor of M220. Raises
    GcodeError where a line asks for what cannot be.
    """

    def __init__(self, dialect: Dialect) -> None:
        self._dialect = dialect
        self.rate = self.speed = DEFAULT_FEED
        self.multiplier = self._kept = 1.0

    def set(self, line: Line, value: float, scale: float) -> None:
        """F, in the file's units a minute; scale: mm in such a unit."""
        if value == 0.0 and self._dialect.zero_feed:
            return
        rate = value * scale / 60.0
        if not 0.0 < rate < math.inf:
            raise line.error("the feed rate must be positive")
        if rate < SLOWEST:
            raise line.error(f"a feed rate below {60.0 * SLOWEST:g} mm/min would never end")
        self.rate, self.speed = rate, rate * self.multiplier

    def factor(self, line: Line, arguments: bytes, words: Words) -> None:
        """M220: S in percent; B keeps the factor for R to bring back, words without a number."""
        given = arguments.upper()
        if self._dialect.keeps_factor and b"B" in given:
            self._kept = self.multiplier
        if self._dialect.keeps_factor and b"R" in given:
            self.multiplier = self._kept
        factor = words["S"] / 100.0 if "S" in words else self.multiplier
        if factor < LEAST_FACTOR:
            raise line.error(f"the speed factor must be at least {100.0 * LEAST_FACTOR:g} %")
        self.multiplier, self.speed = factor, self.rate * factor
