"""Firmware retraction, G10 and G11, as moves of filament where the profile gives its settings.

A firmware remembers that it has retracted, and ignores a second G10 or a lone G11. Its state is
unknown at the start of a file and after a macro. So the first G10 and G11 there pass through, and
after that G11 the state is known. A pair with a macro in between passes through as well.
"""

from __future__ import annotations

import math
from dataclasses import replace

from hframe_post.gcode.commands import Dialect
from hframe_post.gcode.lexer import Words
from hframe_post.printer.settings import Retraction

DEFAULT_DURATION = 0.06  # s; half or twice of it is better than 0
KLIPPER_COMMAND = "SET_RETRACTION"
KLIPPER_PARAMETERS = (
    "RETRACT_LENGTH", "RETRACT_SPEED", "UNRETRACT_EXTRA_LENGTH", "UNRETRACT_SPEED", "Z_HOP_HEIGHT",
)  # fmt: skip
MARLIN_WORDS = {"M207": "SFZ", "M208": "SF"}  # mm, mm/min, mm of lift


class FirmwareRetraction:
    """The retraction settings in force, and whether filament is retracted.

    settings: the profile's; None leaves every G10 and G11 to the firmware.
    """

    def __init__(self, settings: Retraction | None, dialect: Dialect) -> None:
        self._settings, self._dialect = settings, dialect
        self._firmware_is_unretracted = False
        self._retracted = 0.0  # mm that the next G11 returns
        self._return_speed = 0.0  # mm/s

    def forget(self) -> None:
        """Mark the firmware's state as unknown, since a macro may have retracted."""
        self._firmware_is_unretracted = False

    def set(self, name: str, words: Words) -> None:
        """Apply SET_RETRACTION, M207 or M208, which the firmware obeys, too."""
        old = self._settings
        if old is None or (name == KLIPPER_COMMAND) != (self._dialect.name == "klipper"):
            return
        if name == KLIPPER_COMMAND:
            new = Retraction(
                length=words.get("RETRACT_LENGTH", old.length),
                extra=words.get("UNRETRACT_EXTRA_LENGTH", old.extra),
                speed=words.get("RETRACT_SPEED") or old.speed,
                return_speed=words.get("UNRETRACT_SPEED") or old.return_speed,
            )
            lift = words.get("Z_HOP_HEIGHT", 0.0)
        else:
            speed, lift = words.get("F", 0.0) / 60.0, words.get("Z", 0.0)
            if name == "M207":
                length = words.get("S", old.length)
                new = replace(old, length=length, speed=speed or old.speed)
            else:
                extra = words.get("S", old.extra)
                new = replace(old, extra=extra, return_speed=speed or old.return_speed)
        positive = (new.length, new.speed, new.length + new.extra)
        usable = all(math.isfinite(value) and value > 0.0 for value in positive)
        self._settings = new if usable and not lift else None  # only the firmware knows its lifts

    def duration(self, name: str) -> float:
        """Return the estimated seconds of a G10 or G11 that passes through."""
        settings = self._settings
        if settings is None:
            return DEFAULT_DURATION
        if name == "G10":
            return settings.length / settings.speed
        speed = settings.return_speed or settings.speed
        return (settings.length + settings.extra) / speed

    def move(self, name: str, paired: bool) -> tuple[float, float] | None:
        """Return mm of filament and mm/s of a G10 or G11, or None if it must pass through.

        0 mm means that nothing happens. paired: whether a G11 is sure to follow a G10.
        """
        settings, retracts = self._settings, name == "G10"
        if self._retracted:  # by a G10 that was written as a move, unknown to the firmware
            if retracts:
                return 0.0, 1.0
            filament, self._retracted = self._retracted, 0.0
            return filament, self._return_speed
        if settings is None or not self._firmware_is_unretracted or (retracts and not paired):
            self._firmware_is_unretracted = not retracts
            return None
        if not retracts:
            return 0.0, 1.0
        self._retracted = settings.length + settings.extra
        self._return_speed = settings.return_speed or settings.speed
        return -settings.length, settings.speed
