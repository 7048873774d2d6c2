"""What a user chooses of a conversion beside the printer."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from hframe_post.gcode.options import Extrusion, LimitSource
from hframe_post.planner.pacing import Paces
from hframe_post.printer.settings import Speed

Retract = Literal["standing", "moving"]

TOLERANCE = 0.014  # mm by which G-code may be off the computed command; the nozzle is by 1 µm RMS


@dataclass(frozen=True, slots=True)
class Options:
    """What a user chooses beside the printer.

    strategy: what is written; predict: strategies whose contour error is reported;
    limits, extrusion: how the file is read, as in ``ReadOptions``; clamp: whether a command
    beyond a limit is taken back instead of being an error; tolerance: mm of decimation, None
    for every sample; retract: before the travel, or ``moving``, on it. speed: how fast it is
    printed, None: as fast as the file has it; paces: what was found for that, by what is printed.
    """

    strategy: str
    predict: tuple[str, ...] = ()
    limits: LimitSource = "file"
    clamp: bool = False
    tolerance: float | None = TOLERANCE
    extrusion: Extrusion | None = None
    retract: Retract = "standing"
    speed: Speed | None = None
    paces: Paces | None = None

    @property
    def strategies(self) -> tuple[str, ...]:
        """Every strategy that must be computed."""
        return tuple(dict.fromkeys((self.strategy, *self.predict)))
