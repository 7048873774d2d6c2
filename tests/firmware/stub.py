"""A third firmware, made by the recipe of docs/architecture.md: it turns corners without braking.

``add`` makes it known to this process, ``installed`` to those that a test starts.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from hframe_post.arrays import Array, E, Flags, Integers, lengths
from hframe_post.firmware.base import Firmware, Source
from hframe_post.firmware.code import Code, coordinates, modes, plain
from hframe_post.firmware.dialect import Dialect
from hframe_post.firmware.motion import MotionRules, NextTo
from hframe_post.firmware.registry import FIRMWARES
from hframe_post.model.shapers import Shaping
from hframe_post.native.ramps import whole_feeds
from hframe_post.printer.firmware_tables import TABLES, FirmwareTable
from hframe_post.printer.new_profile import Known, Tables
from hframe_post.printer.schema import positive
from hframe_post.printer.settings import Printer
from hframe_post.stream.types import ModalState

SAMPLES = 4  # in a segment


@dataclass(frozen=True, slots=True)
class StubTable(FirmwareTable):
    holds: ClassVar[str] = "the stub's own settings"
    title: ClassVar[str] = "settings of the stub"

    acceleration: float = positive(most=1e7)


class StubMotion(MotionRules):
    def segments(self, points: Array, forced: Flags, last: bool) -> tuple[Integers, Array]:
        n = len(points) - 1
        ends = np.unique([*range(SAMPLES, n, SAMPLES), *np.flatnonzero(forced[1:]) + 1, n])
        return ends, points[ends]

    def feeds(
        self, at: Array, T: Array, rest: Flags, before: float, after: float, per_feed: float
    ) -> tuple[Integers, Array]:
        feeds = whole_feeds(lengths(np.diff(at[:, :E], axis=0)) / T, per_feed)
        return feeds, self.durations(at, feeds / per_feed, rest, before)

    def durations(
        self, at: Array, v: Array, rest: Flags, before: float, after: float = math.inf
    ) -> Array:
        return np.asarray(lengths(np.diff(at[:, :E], axis=0)) / v)

    def dwell(self, seconds: float, next_to: NextTo) -> tuple[bytes, float] | None:
        waited = max(round(seconds, 3), 0.0)
        return (b"G4 P%d\n" % round(1e3 * waited), waited) if waited else None


@dataclass(frozen=True, slots=True)
class StubCode(Code):
    table: StubTable

    def begin(self, offset: tuple[float, float, float], at: Array) -> list[str]:
        return ["M204 S100000", "G90", "M83", *coordinates(offset, at)]

    def end(self, state: ModalState, at: Array) -> list[str]:
        place = coordinates(state.offset, at[:E] - state.offset)
        return [self._acceleration(self.table.acceleration), *place, *modes(state)]

    def set_limits(self, velocity: float, acceleration: float, corner: float) -> list[str]:
        return [f"M203 X{plain(velocity, 0)}", self._acceleration(acceleration)]

    def _acceleration(self, acceleration: float) -> str:
        return f"M204 S{plain(acceleration, 0)}"


class Stub(Firmware):
    name, table = "stub", StubTable
    dialect = Dialect(frozenset({"M204"}))
    configuration = "stub.txt"

    def motion(self, tolerance: float | None) -> StubMotion:
        return StubMotion()

    def code(self) -> StubCode:
        return StubCode(self.printer.firmware.own(StubTable))

    @staticmethod
    def shaper_settings(shaping: Shaping) -> str:
        return f"SHAPE X{shaping.x.hz:.1f} Y{shaping.y.hz:.1f}"

    @classmethod
    def source(cls, files: Sequence[Path]) -> Source | None:
        return StubSource(files[0]) if files[0].name == cls.configuration else None


class StubSource(Source):
    """The acceleration (mm/s²) as the only word of a file."""

    possible, decided, warnings, sensors = ("corexy",), "the stub", list[str](), "none"

    def __init__(self, path: Path) -> None:
        self.path, self._acceleration = path, Known(float(path.read_text()), "the file")
        self.no_travel = "add --bed 220,220"

    def tables(self, kinematics: str, bed: tuple[float, float] | None) -> Tables:
        a, speed, size = self._acceleration, Known(100.0, "always"), bed or (0.0, 0.0)
        names = ("z_velocity", "extruder_velocity")
        limits = {"velocity": speed, "acceleration": a, "square_corner_velocity": Known(5.0, "")}
        limits |= dict.fromkeys(names, speed)
        limits |= dict.fromkeys((name.replace("velocity", "acceleration") for name in names), a)
        return {
            "travel": {k: Known((0.0, v), "") for k, v in zip("xy", size, strict=True)},
            "limits": limits,
            "firmware.stub": {"acceleration": a},
        }

    def next_steps(self, profile: Printer, target: Path, quoted: Callable[[Path], str]) -> str:
        return f"Measure {quoted(target)}."


def add() -> None:
    """Add the stub to the firmwares, as a program of its owner does."""
    FIRMWARES[Stub.name] = Stub
    TABLES[Stub.name] = StubTable


def remove() -> None:
    """Undo ``add``."""
    del FIRMWARES[Stub.name], TABLES[Stub.name]
