"""Firmware retraction, G10 and G11, as moves of filament: what they do where the profile tells.

A firmware remembers that it has retracted, and ignores a second G10 or a lone G11. Whether it has
is not known when a file begins, nor after a macro. So the first pair there is the firmware's own,
and from its G11 on everything is known; and so is a pair with a macro between its two.
"""

from __future__ import annotations

import math
from dataclasses import replace

from hframe_post.gcode.commands import Dialect, Words
from hframe_post.printer.settings import Retraction

USUAL = 0.06  # s of a retraction that only the firmware knows; half or twice of it is better than 0
PAIRED = 500  # lines within which a G10 has its G11
MACRO = "SET_RETRACTION"
PARAMETERS = (
    "RETRACT_LENGTH", "RETRACT_SPEED", "UNRETRACT_EXTRA_LENGTH", "UNRETRACT_SPEED", "Z_HOP_HEIGHT",
)  # fmt: skip
SETTINGS = {"M207": "SFZ", "M208": "SF"}  # of Marlin: mm, mm/min, mm of lift


class FirmwareRetraction:
    """What is set, and what is known of the filament.

    own: the profile's; None: all is left to the firmware.
    """

    def __init__(self, own: Retraction | None, dialect: Dialect) -> None:
        self._own, self._dialect = own, dialect
        self._known = False  # that the firmware itself holds nothing back
        self._back = self._speed_back = 0.0  # mm that the next G11 brings, and how fast

    def lost(self) -> None:
        """A macro may have retracted."""
        self._known = False

    def set(self, name: str, words: Words) -> None:
        """SET_RETRACTION, M207 or M208, which the firmware obeys, too."""
        own = self._own
        klippers = self._dialect.name == "klipper"
        if own is None or (name == MACRO) != klippers:
            return
        if not klippers and self._dialect.name != "marlin":  # whose words mean other things
            self._own = None
            return
        if name == MACRO:
            speeds = words.get("RETRACT_SPEED"), words.get("UNRETRACT_SPEED")
            length, extra = words.get("RETRACT_LENGTH"), words.get("UNRETRACT_EXTRA_LENGTH")
            lift = words.get("Z_HOP_HEIGHT", 0.0)
        else:
            speed = words["F"] / 60.0 if "F" in words else None
            first = name == "M207"
            speeds = (speed, None) if first else (None, speed)
            length, extra = (words.get("S"), None) if first else (None, words.get("S"))
            lift = words.get("Z", 0.0)
        self._own = replace(
            own,
            length=own.length if length is None else length,
            extra=own.extra if extra is None else extra,
            speed=speeds[0] or own.speed, return_speed=speeds[1] or own.return_speed,
        )  # fmt: skip
        if lift or not self._sound:  # lifts are the firmware's
            self._own = None

    def seconds(self, name: str) -> float:
        """How long a G10 or G11 takes that passes, as far as can be told."""
        own = self._own
        if own is None:
            return USUAL
        if name == "G10":
            return own.length / own.speed
        return (own.length + own.extra) / (own.return_speed or own.speed)

    @property
    def _sound(self) -> bool:
        own = self._own
        return own is not None and all(
            math.isfinite(v) and v > 0.0 for v in (own.length, own.speed, own.length + own.extra)
        )

    def of(self, name: str, paired: bool) -> tuple[float, float] | None:
        """mm of filament and mm/s of G10 or G11; 0 mm: nothing happens; None: let it pass.

        paired: whether of a G10 the G11 is sure to come here.
        """
        own, retracts = self._own, name == "G10"
        if self._back:  # by a G10 that was written out, of which the firmware knows nothing
            if retracts:
                return 0.0, 1.0
            filament, self._back = self._back, 0.0
            return filament, self._speed_back
        if own is None or not self._known or (retracts and not paired):
            self._known = not retracts
            return None
        if not retracts:
            return 0.0, 1.0
        self._back = own.length + own.extra
        self._speed_back = own.return_speed or own.speed
        return -own.length, own.speed
