"""What E means: absolute or relative where a file does not say so, and firmware retraction."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np

from hframe_post.arrays import Array
from hframe_post.errors import GcodeError
from hframe_post.firmware.dialect import Dialect
from hframe_post.gcode.commands import Line, command, numbers_among, parameters
from hframe_post.printer.settings import Retraction


def is_absolute(lines: Iterable[Line], x: float, y: float, e: float) -> bool | None:
    """Return whether lines show an absolute E, by moves or a later M82; None if unclear.

    They end at the first M82 or M83. x, y, e: before them as the file names them; nan: unknown.
    """
    moves = list(_extruding_moves(lines, {"X": x, "Y": y}, e))
    mode = moves.pop() if moves and isinstance(moves[-1], bool) else None
    by_moves = _shown_by(np.array(moves).reshape(-1, 3))
    return True if by_moves is None and mode else by_moves


def _shown_by(table: Array) -> bool | None:
    """Return whether moves, see ``_extruding_moves``, show an absolute E; None if unclear."""
    if len(table) <= 1:
        return True  # a single E is the same either way
    path, e, before = table[table[:, 0] > 0.05].T  # mm; shorter moves are mostly rounding
    relative = e / path
    absolute = ((e - before) / path)[np.isfinite(before)]
    if len(absolute) < 2:
        return None
    relative_spread, absolute_spread = _spread(relative), _spread(absolute)
    if len(absolute) == 2:  # a line and its way back
        return True if absolute_spread < 0.01 < relative_spread else None
    if relative_spread < math.inf and relative_spread <= 0.5 * absolute_spread:
        return False
    if absolute_spread < math.inf and absolute_spread <= 0.5 * relative_spread:
        return True
    return None


def _spread(ratio: Array) -> float:
    """Return how much the extrusion per mm varies between moves: about 0 if it is constant.

    Moves that would take filament back count as well, as only a few wipes do.
    """
    median = float(np.median(ratio))
    if median <= 0.0:
        return math.inf
    return float(np.median(np.abs(ratio - median))) / median + float((ratio <= 0.0).mean())


def _extruding_moves(
    lines: Iterable[Line], at: dict[str, float], before: float
) -> Iterator[tuple[float, float, float] | bool]:
    """Yield path length, E and the E before (nan: unknown) of moves with E, up to M82 or M83.

    The last is then whether that was M82.
    """
    absolute = True
    for line in lines:
        try:
            coded = command(line)
            words = numbers_among(line, coded.arguments, "XYE") if coded else {}
        except GcodeError:
            return  # the reader reports it when it comes to this line
        if coded is None:
            continue
        if coded.name in ("M82", "M83"):
            yield coded.name == "M82"
            return
        if coded.name in ("G90", "G91"):
            absolute = coded.name == "G90"
        elif coded.name == "G92":
            before = words.get("E", before)
        elif coded.name in ("G0", "G1", "G2", "G3"):
            step = {a: v if not absolute else v - at[a] for a, v in words.items() if a != "E"}
            path = math.hypot(*step.values()) if step else 0.0
            at |= {a: at[a] + s if not absolute else words[a] for a, s in step.items()}
            if "E" in words:
                yield path, words["E"], before
            if "E" in words and (path > 0.0 or not math.isfinite(before)):
                before = words["E"]


RETRACTION_S = 0.06  # s; half or twice of it is better than 0
SET_RETRACTION = (
    "RETRACT_LENGTH", "RETRACT_SPEED", "UNRETRACT_EXTRA_LENGTH", "UNRETRACT_SPEED", "Z_HOP_HEIGHT",
)  # fmt: skip
RETRACTION_WORDS = {"M207": "SFZ", "M208": "SF"}  # mm, mm/min, mm of lift


class FirmwareRetraction:
    """G10 and G11 as moves of filament, where the profile gives its ``settings``.

    A firmware remembers that it has retracted, and ignores a second G10 or a lone G11. Its state is
    unknown at the start of a file and after a macro. So the first G10 and G11 there pass through,
    and after that G11 the state is known. A pair with a macro in between passes through as well.
    """

    def __init__(self, settings: Retraction | None, dialect: Dialect) -> None:
        self._settings, self._dialect = settings, dialect
        self._firmware_is_unretracted = False
        self._retracted = 0.0  # mm that the next G11 returns
        self._return_speed = 0.0  # mm/s

    def forget(self) -> None:
        """Mark the firmware's state as unknown, since a macro may have retracted."""
        self._firmware_is_unretracted = False

    def apply(self, line: Line, name: str, arguments: bytes) -> None:
        """Apply SET_RETRACTION, M207 or M208, which the firmware obeys, too; ignore the others."""
        old = self._settings
        if old is None or name not in self._dialect.retraction_settings:
            return
        if name == "SET_RETRACTION":
            words = parameters(line, SET_RETRACTION)
            new = Retraction(
                length=words.get("RETRACT_LENGTH", old.length),
                extra=words.get("UNRETRACT_EXTRA_LENGTH", old.extra),
                speed=words.get("RETRACT_SPEED") or old.speed,
                return_speed=words.get("UNRETRACT_SPEED") or old.return_speed,
            )
            lift = words.get("Z_HOP_HEIGHT", 0.0)
        else:
            words = numbers_among(line, arguments, RETRACTION_WORDS[name])
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
            return RETRACTION_S
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
