"""The limits that a file asks for, as its lines set them."""

from __future__ import annotations

import math

from hframe_post.gcode import commands
from hframe_post.stream.types import FileLimits


class Asked:
    """Path acceleration, square-corner velocity and axis limits; inf where none was asked."""

    def __init__(self, firmware: str) -> None:
        self._firmware = firmware
        self.acceleration = self.corner = math.inf
        self.limits = FileLimits((math.inf,) * 4, (math.inf,) * 4)

    @staticmethod
    def changes_axes(name: str, words: dict[str, float]) -> bool:
        """Whether a command changes ``limits``, which hold for whole blocks of moves."""
        return name in ("M201", "M203") or "VELOCITY" in words

    def command(self, name: str, words: dict[str, float]) -> None:
        """M201, M203, M204, M205 or SET_VELOCITY_LIMIT, with its words or NAME=value."""
        velocity, acceleration = self.limits.velocity, self.limits.acceleration
        if name == "M204":
            self.acceleration = commands.acceleration(words, self._firmware, self.acceleration)
        elif name == "M205":
            corner = [words[letter] for letter in "XY" if letter in words]
            self.corner = min(corner, default=self.corner)
        elif name == "M201":
            x, y, z, e = (words.get(a, v) for a, v in zip("XYZE", acceleration, strict=True))
            self.limits = FileLimits(velocity, (x, y, z, e))
        elif name == "M203":
            x, y, z, e = (words.get(a, v) for a, v in zip("XYZE", velocity, strict=True))
            self.limits = FileLimits((x, y, z, e), acceleration)
        else:
            self.acceleration = words.get("ACCEL", self.acceleration)
            self.corner = words.get("SQUARE_CORNER_VELOCITY", self.corner)
            v = words.get("VELOCITY")
            if v is not None:
                self.limits = FileLimits((v, v, *velocity[2:]), acceleration)
