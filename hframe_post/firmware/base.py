"""What a firmware is: what it reads, how it moves, its input shapers, its own files."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import ClassVar

import numpy as np

from hframe_post.arrays import Array, Z
from hframe_post.firmware.code import Code
from hframe_post.firmware.dialect import Advance, Dialect
from hframe_post.firmware.motion import MotionRules, WrittenMoves
from hframe_post.model.shapers import Shaping
from hframe_post.native.planning import square_corner_velocity
from hframe_post.printer.firmware_tables import FirmwareTable
from hframe_post.printer.new_profile import Finding, Tables, differences
from hframe_post.printer.settings import Limits, Printer, Steps
from hframe_post.stream.types import FileLimits, Position


class Source(ABC):
    """Files that describe a printer. possible: its kinematics, the safest first; decided: why.

    warnings: what the owner must know before a print. sensors: accelerometers that are known.
    alone: why `setup` takes a single file and no --bed, if it does. no_travel: why the ranges of x
    and y are not known, if they are not. missing: what could not be read, if anything.
    """

    path: Path
    possible: tuple[str, ...]
    decided: str
    warnings: list[str]
    sensors: str
    alone: str = ""
    no_travel: str = ""

    @property
    def missing(self) -> str:
        return ""

    @abstractmethod
    def tables(self, kinematics: str, bed: tuple[float, float] | None) -> Tables:
        """Return the settings of a new profile. Raises HframeError if a number is missing.

        bed: width and depth, mm, if the owner said them.
        """

    def findings(self, profile: Printer, remedy: str, again: str) -> Iterator[Finding]:
        """Yield what is wrong with the printer for files that are converted with a profile.

        remedy: what to do where both differ; again: how companions are written again. Raises
        HframeError, OSError.
        """
        yield from self.differing(profile, remedy)

    def differing(self, profile: Printer, remedy: str) -> Iterator[Finding]:
        """Yield where the printer would not move as a profile says."""
        kind = profile.kinematics.type
        if kind not in self.possible:
            is_for = f'but the profile has kinematics.type = "{kind}"'
            text = f"{self.path}: {self.decided}: {' or '.join(self.possible)}, {is_for}"
            yield Finding(True, f"{text}: {remedy}")
        x, y = profile.travel.x[1], profile.travel.y[1]
        for each in differences(self.tables(kind, (x, y) if self.no_travel else None), profile):
            if each.wrong:
                yield Finding(True, f"{each.place or self.path}: {each.text}: {remedy}")

    def companions(self, profile: Printer) -> dict[str, str]:
        """Return texts by name of the files that the printer needs next to its own."""
        return {}

    @abstractmethod
    def next_steps(self, profile: Printer, target: Path, quoted: Callable[[Path], str]) -> str:
        """Return what to do after `setup` has written the profile.

        quoted: returns a path as a shell takes it.
        """


CORNER_ROUNDING = 5e-3  # share by which `setup` rounds the speed through a right angle
UNLIMITED_DEVIATION = 1e3  # mm, more than any board has: it tells that the board has one

# seconds (n,) of moves: steps that their leading motor makes, their length, speeds at both ends and
# between, acceleration, (n,) each
Durations = Callable[[Array, Array, Array, Array, Array, Array], Array]


@dataclass(frozen=True, slots=True)
class FirmwareLimits:
    """Limits that a firmware plans a file with; mm, s.

    limits: of any move. Until the file sets others, printing and travel are the accelerations,
    corner is the speed through a right angle, and others has what else holds. durations: of moves;
    None: those of exact ramps. step: mm of motors A and B, z and e. least: steps of the shortest
    move, which joins shorter ones; 0: it makes every move. late: mm by which it brakes late.
    """

    limits: Limits
    printing: float
    travel: float
    corner: float
    others: FileLimits = field(default_factory=FileLimits)
    durations: Durations | None = None
    step: Position = (1.0, 1.0, 1.0, 1.0)
    least: int = 0
    late: float = 0.0

    @property
    def joins(self) -> bool:
        """Return whether junctions are those of a board with junction deviation."""
        return math.isfinite(self.limits.junction_deviation)

    @property
    def motors(self) -> Array:
        """Return the matrix (4, 4) from x, y, z, e to steps of A, B, z, e."""
        mm = np.eye(4)
        mm[:Z, :Z] = self.others.belts
        return np.asarray(mm / np.array(self.step)[:, None])


class Firmware(ABC):
    """A firmware on one printer: what it reads, how it moves, its limits, its own files.

    name: in profiles and on the command line. table: its table in profiles. dialect: what it reads.
    decimates: its segments depend on the tolerance. shapers: names of the input shapers that every
    version has; newer_versions: those that have the shapers with parameters, too, if any do.
    configuration: a file that `setup` reads and `doctor` compares with a profile.
    """

    name: ClassVar[str]
    table: ClassVar[type[FirmwareTable]]
    dialect: ClassVar[Dialect]
    decimates: ClassVar[bool] = False
    shapers: ClassVar[tuple[str, ...]] = ("zv",)
    newer_versions: ClassVar[str] = ""
    configuration: ClassVar[str]

    def __init__(self, printer: Printer) -> None:
        self.printer = printer

    @abstractmethod
    def motion(self, tolerance: float | None) -> MotionRules:
        """Return its motion.

        tolerance: of decimation, mm; None keeps every sample.
        """

    @abstractmethod
    def code(self) -> Code:
        """Return its G-code."""

    def reads(self) -> Dialect:
        """Return what its build on this printer reads. Default: what all builds do."""
        return self.dialect

    def moves(self) -> WrittenMoves:
        """Return how it plays moves as they are written."""
        return WrittenMoves(self.code())

    def advance(self) -> Advance:
        """Return the pressure advance until the file sets another. Default: the profile's."""
        return Advance.of_extruder(self.printer.extruder, self.dialect.advance)

    def limits(self) -> FirmwareLimits:
        """Return the limits with which it plays a file as sliced. Default: those of the profile."""
        own = self.printer.limits
        others = FileLimits(path=own.velocity, belts=self.belts)
        return FirmwareLimits(
            unlimited(own), own.acceleration, own.acceleration, own.square_corner_velocity, others
        )

    def caps(self) -> Limits:
        """Return the profile's limits, without those that a file may raise.

        Its speed, acceleration and speed at corners bind what files ask where they differ from the
        firmware's own: then the printer's owner chose them.
        """
        own, limits = self.limits(), self.printer.limits
        of_motors = [min(pair[:Z]) for pair in (own.others.velocity, own.others.acceleration)]
        acceleration, corner = min(own.printing, of_motors[1]), own.corner
        if math.isfinite(own.others.deviation):
            corner = square_corner_velocity(own.others.deviation, acceleration)
        known = {
            "velocity": (min(own.others.path, of_motors[0]), math.inf),
            "acceleration": (acceleration, math.inf),
            "square_corner_velocity": (corner, math.inf),
            "junction_deviation": (own.others.deviation, UNLIMITED_DEVIATION),
        }
        return replace(limits, **{
            name: free for name, (value, free) in known.items()
            if math.isclose(getattr(limits, name), value, rel_tol=CORNER_ROUNDING)
            and math.isfinite(value)
        })  # fmt: skip

    def most(self) -> tuple[float, float]:
        """Return the speed, mm/s, and the acceleration, mm/s², that the firmware itself allows."""
        return math.inf, math.inf

    @staticmethod
    @abstractmethod
    def shaper_settings(shaping: Shaping) -> str:
        """Return the section of a configuration, or the commands, that set input shapers."""

    @classmethod
    def source(cls, files: Sequence[Path]) -> Source | None:
        """Return what these files say of a printer; None if they are not of this firmware.

        Raises HframeError.
        """
        return None

    @property
    def steps(self) -> Steps | None:
        """Return the motors' steps if their size matters for the print."""
        return None if self.decimates else self.printer.steps

    def check_serial(self) -> None:
        """Raise PrinterError if the profile does not allow printing over a serial line."""
        return

    @property
    def belts(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Return the matrix from x, y to the motors A, B."""
        (ax, ay), (bx, by) = self.printer.kinematics.matrix.tolist()
        return (ax, ay), (bx, by)


def unlimited(limits: Limits, deviation: float = math.inf) -> Limits:
    """Return the limits without those that a file sets, and those that only this tool has.

    deviation: UNLIMITED_DEVIATION on a board with junction deviation.
    """
    return replace(
        limits, velocity=math.inf, acceleration=math.inf, square_corner_velocity=math.inf,
        junction_deviation=deviation, jerk=1e12,
    )  # fmt: skip
