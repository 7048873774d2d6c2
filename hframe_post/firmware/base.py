"""What a firmware is: what it reads, how it moves, its input shapers, its own files."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

from hframe_post.arrays import Array
from hframe_post.firmware.advance import Advance
from hframe_post.firmware.code import Code
from hframe_post.firmware.configuration import Finding, Source
from hframe_post.firmware.dialect import Dialect
from hframe_post.firmware.motion import MotionRules
from hframe_post.firmware.written_moves import WrittenMoves
from hframe_post.model.shapers import Shaping
from hframe_post.printer.firmware_tables import FirmwareTable
from hframe_post.printer.settings import Limits, Printer

MOST = 1e6  # mm/s², as much as limits may be

# seconds (n,) of moves: mm that their leading motor makes, their length, speeds at both ends and
# between, acceleration, (n,) each
Durations = Callable[[Array, Array, Array, Array, Array, Array], Array]


@dataclass(frozen=True, slots=True)
class FirmwareLimits:
    """Limits that a firmware plans a file with; mm, s.

    limits: of any move. printing, travel: accelerations until the file sets others. motors:
    accelerations of A and B until the file sets others, if motors are limited; belts (2, 2): from
    x, y to A, B. cruise_ratio: of a move that brakes as soon as it has accelerated, the share that
    must be at constant speed. durations: of moves; None: those of exact ramps.
    """

    limits: Limits
    printing: float
    travel: float
    motors: tuple[float, float] = (math.inf, math.inf)
    belts: Array | None = None
    cruise_ratio: float = 0.0
    durations: Durations | None = None


class Firmware(ABC):
    """A firmware, for any printer.

    name: in profiles and on the command line. table: its table in profiles. dialect: what it reads.
    decimates: its segments depend on the tolerance. shapers: names of the input shapers that every
    version has; newer_versions: those that have the shapers with parameters, too, if any do.
    configuration: a file that `setup` reads. compared: the one that `doctor` compares with a
    profile, if any; unchecked: what `doctor` notes where it compares none.
    """

    name: ClassVar[str]
    table: ClassVar[type[FirmwareTable]]
    dialect: ClassVar[Dialect]
    decimates: ClassVar[bool] = False
    shapers: ClassVar[tuple[str, ...]] = ("zv",)
    newer_versions: ClassVar[str] = ""
    configuration: ClassVar[str]
    compared: ClassVar[str] = ""
    unchecked: ClassVar[str]

    @abstractmethod
    def motion(
        self, printer: Printer, tolerance: float | None, retract_moving: bool = False
    ) -> MotionRules:
        """Return its motion on a printer.

        tolerance: of decimation, mm; None keeps every sample. retract_moving: filament is retracted
        in motion. Raises PrinterError where the profile lacks the firmware's table, HframeError
        where it cannot retract in motion.
        """

    @abstractmethod
    def code(self, printer: Printer) -> Code:
        """Return its G-code on a printer. Raises PrinterError without the firmware's table."""

    def reads(self, printer: Printer) -> Dialect:
        """Return what its build on this printer reads. Default: what all builds do."""
        return self.dialect

    def moves(self, printer: Printer) -> WrittenMoves:
        """Return how it plays moves as they are written. Raises PrinterError without its table."""
        return WrittenMoves(self.code(printer))

    def advance(self, printer: Printer) -> Advance:
        """Return the pressure advance until the file sets another. Default: the profile's."""
        return Advance.from_printer(printer, self.dialect.advance)

    def limits(self, printer: Printer) -> FirmwareLimits:
        """Return the limits with which it plays a file as sliced. Default: those of the profile."""
        own = unlimited(printer.limits)
        return FirmwareLimits(own, own.acceleration, own.hardest)

    def most(self, printer: Printer) -> tuple[float, float]:
        """Return the speed, mm/s, and the acceleration, mm/s², that the firmware itself allows."""
        return math.inf, math.inf

    @abstractmethod
    def shaper_settings(self, shaping: Shaping) -> str:
        """Return the section of a configuration, or the commands, that set input shapers."""

    def source(self, files: Sequence[Path]) -> Source | None:
        """Return what these files say of a printer; None if they are not of this firmware.

        Raises HframeError.
        """
        return None

    def host_findings(
        self, config: Path, log: Path | None, printer: Printer, remedy: str
    ) -> Iterable[Finding]:
        """Return what is wrong with the firmware's host, apart from its printer's settings.

        config, log: of the host. remedy: how what the profile gives is written again. Raises
        HframeError.
        """
        return ()

    def check_serial(self, printer: Printer) -> None:
        """Raise PrinterError if the profile does not allow printing over a serial line."""
        return


def unlimited(limits: Limits, **others: Any) -> Limits:
    """Return the limits without those of jerk and braking, which only this tool has.

    others: replace those of these names.
    """
    own = replace(limits, **others)
    return replace(
        own, jerk=1e12, deceleration=math.inf, travel_velocity=0.0, travel_acceleration=0.0,
        acceleration_by_axis=False,
    )  # fmt: skip
