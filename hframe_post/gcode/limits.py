"""The limits that a file requests, as its lines set them."""

from __future__ import annotations

import math
from dataclasses import replace

from hframe_post.gcode.commands import Dialect, Words
from hframe_post.gcode.lexer import Line
from hframe_post.stream.types import FileLimits

MAY_BE_ZERO = ("M205", "SQUARE_CORNER_VELOCITY", "MINIMUM_CRUISE_RATIO")
LEAST_VELOCITY = 0.1  # mm/s; below it a print would never end
LEAST_ACCELERATION = 1.0  # mm/s²


class RequestedLimits:
    """Path acceleration, square-corner velocity and axis limits; inf where none was requested.

    acceleration: of moves that extrude; travel: of those that do not.
    """

    def __init__(self, dialect: Dialect) -> None:
        self._dialect = dialect
        self.acceleration = self.travel = self.corner = math.inf
        self.axes = FileLimits((math.inf,) * 4, (math.inf,) * 4)

    def take(self, line: Line, name: str, words: Words) -> None:
        """M201, M203, M204, M205 or SET_VELOCITY_LIMIT, with its words or NAME=value.

        Raises GcodeError where a limit would stop the print, or nearly so.
        """
        for word, value in words.items():
            least = LEAST_VELOCITY if name == "M203" or word == "VELOCITY" else LEAST_ACCELERATION
            least = 0.0 if name in MAY_BE_ZERO or word in MAY_BE_ZERO else least
            if value < least:
                raise line.error(f"{word} must be at least {least:g}")
        velocity, acceleration = self.axes.velocity, self.axes.acceleration
        if name == "M204":
            before = self.acceleration, self.travel
            self.acceleration, self.travel = self._dialect.path_acceleration(words, before)
            if "S" in words or "T" in words:
                self.axes = replace(self.axes, travel=words.get("T", math.inf))
        elif name == "M205":
            corner = [words[letter] for letter in "XY" if letter in words]
            self.corner = min(corner, default=self.corner)
        elif name == "M201":
            x, y, z, e = (words.get(a, v) for a, v in zip("XYZE", acceleration, strict=True))
            self.axes = replace(self.axes, acceleration=(x, y, z, e))
        elif name == "M203":
            x, y, z, e = (words.get(a, v) for a, v in zip("XYZE", velocity, strict=True))
            self.axes = replace(self.axes, velocity=(x, y, z, e))
        else:
            self.acceleration = self.travel = words.get("ACCEL", self.acceleration)
            self.corner = words.get("SQUARE_CORNER_VELOCITY", self.corner)
            v = words.get("VELOCITY")
            if v is not None:
                self.axes = replace(self.axes, velocity=(v, v, *velocity[2:]))
