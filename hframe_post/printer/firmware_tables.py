"""The tables ``[firmware.…]`` of a profile: a firmware's own settings, and how it was built.

A table has its firmware's name. ``TABLES`` has them all. What else a firmware is, is in the
package ``firmware``; a table's class says only what a profile must know.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field, fields, replace
from typing import Any, ClassVar, TypeVar

from hframe_post.errors import PrinterError
from hframe_post.printer.schema import checked, known_keys, not_negative, positive, within

FASTEST, HARDEST = 1e4, 1e7  # largest mm/s and mm/s² of a setting
MARLIN_PLANNERS = ("2.0", "2.1", "2.1-dev", "ft-motion")
S_CURVES = ("2.0", "2.1")  # planners whose S_CURVE_ACCELERATION is modelled
MACROS = "hframe.cfg"  # what `setup` writes for Klipper
END_MACRO = "_HFRAME_END"  # one of them: restores what printer.cfg sets, whatever the profile says
RECORDED = "_HFRAME_RECORDED"  # another: puts the print time into a recording's name
UNUSED = "hframe-unused"  # name of the recordings that it throws away
USUAL_CHIP = "adxl345"  # of [adxl345] in printer.cfg
NAMES = {"pattern": re.compile(r"[A-Za-z_][\w.]*\*?", re.ASCII)}  # of commands and macros


@dataclass(frozen=True, slots=True)
class FirmwareTable:
    """A firmware's own settings.

    holds, title: what they are, in an error and in a new profile. needs_steps: the reason why the
    profile must have ``[steps]``, if it must. records: it records accelerometers by itself.
    """

    holds: ClassVar[str]
    title: ClassVar[str]
    needs_steps: ClassVar[str] = ""
    records: ClassVar[bool] = False


T = TypeVar("T", bound=FirmwareTable)


@dataclass(frozen=True, slots=True)
class KlipperTable(FirmwareTable):
    """Klipper's own limits, which hold before and after the print.

    lines_per_second: as many as the host shall take. end_macro: macro to call after the commands
    that restore limits; Klipper goes on if it has no macro of that name.
    """

    holds: ClassVar[str] = "Klipper's own limits"
    title: ClassVar[str] = "limits before and after a print"
    records: ClassVar[bool] = True

    velocity: float = positive(most=FASTEST)
    acceleration: float = positive(most=HARDEST)
    square_corner_velocity: float = not_negative(5.0, most=FASTEST)
    minimum_cruise_ratio: float = field(default=0.5, metadata={"least": 0.0, "below": 1.0})
    shaper_freq_x: float = not_negative(0.0, most=1e3)
    shaper_freq_y: float = not_negative(0.0, most=1e3)
    shaper_freq_z: float = not_negative(0.0, most=1e3)
    lines_per_second: float = within(20.0, 1e3, default=math.inf)
    end_macro: str = ""


@dataclass(frozen=True, slots=True)
class MarlinTable(FirmwareTable):
    """Marlin's own settings, which hold before and after the print, and bounds on the output.

    Corners follow ``junction_deviation`` or, in builds with CLASSIC_JERK, ``jerk`` (x, y) and
    ``jerk_e``; the others are 0. baud: of the serial line that files are printed over; 0: from SD.
    latency: s in which the sender takes up an ok. fixed_time_trajectory and
    fixed_time_smoothing (s): those of M494, of builds of 2026.
    bed_levelling: a mesh is stored, which M420 S1 turns on after G28.
    soft_endstops: ranges of x, y and z, mm, at whose ends M211 S1 stops moves; none: not known.
    """

    holds: ClassVar[str] = "Marlin's own settings"
    title: ClassVar[str] = "settings before and after a print: those of M503"
    needs_steps: ClassVar[str] = "Marlin needs whole steps"

    max_velocity: tuple[float, float] = positive(most=FASTEST)
    max_acceleration: tuple[float, float] = positive(most=HARDEST)
    acceleration: float = positive(most=HARDEST)
    travel_acceleration: float = positive(most=HARDEST)
    retract_acceleration: float = not_negative(0.0, most=HARDEST)
    max_acceleration_e: float = not_negative(0.0, most=HARDEST)
    junction_deviation: float = not_negative(0.0, most=1.0)
    jerk: tuple[float, float] = not_negative((0.0, 0.0), most=1e3)
    jerk_e: float = not_negative(0.0, most=1e3)
    min_segment_time: float = not_negative(0.02, most=1.0)
    min_velocity: float = not_negative(0.0, most=FASTEST)
    min_travel_velocity: float = not_negative(0.0, most=FASTEST)
    linear_advance: float = not_negative(0.0, most=10.0)
    shaper_freq_x: float = not_negative(0.0, most=1e3)
    shaper_freq_y: float = not_negative(0.0, most=1e3)
    fixed_time_motion: int = not_negative(0, most=99)
    fixed_time_trajectory: int = not_negative(0, most=99)
    fixed_time_smoothing: tuple[float, float] = not_negative((0.0, 0.0), most=1.0)
    fixed_time_smoothing_z_e: tuple[float, float] = not_negative((0.0, 0.0), most=1.0)
    fixed_time_shaper: tuple[float, float] = not_negative((0.0, 0.0), most=99.0)
    lines_per_second: float = positive(250.0, below=1001.0)
    baud: int = not_negative(0, most=10**7)
    latency: float = not_negative(0.002, most=1.0)
    min_steps_per_segment: int = positive(6, most=1000)
    timer_hz: float = within(1e5, 1e9, default=2e6)
    timer_extra_tick: bool = False
    planner: str = field(default="2.1", metadata={"choices": MARLIN_PLANNERS})
    adaptive_step_smoothing: float = not_negative(0.0, most=1e7)
    s_curve_acceleration: bool = False
    bed_levelling: bool = False
    soft_endstops: tuple[tuple[float, float], ...] = field(
        default=(), metadata={"count": 3, "ascending": True, "least": -1e4, "most": 1e4}
    )

    def __post_init__(self) -> None:
        jerks = (*self.jerk, self.jerk_e)
        if any(jerks) != all(jerks) or any(jerks) == bool(self.junction_deviation):
            cause = "set either this or, for a build with CLASSIC_JERK, jerk and jerk_e"
            raise PrinterError(cause, "firmware.marlin.junction_deviation")
        if self.s_curve_acceleration and self.planner not in S_CURVES:
            cause = (
                f"works with planner {' and '.join(S_CURVES)} only; turn it off in Marlin's build"
            )
            raise PrinterError(cause, "firmware.marlin.s_curve_acceleration")

    @property
    def lines_received(self) -> float:
        """Return the lines that arrive and are planned in a second."""
        if not self.baud:
            return self.lines_per_second
        bits = 10 * 45  # a line with number and checksum, and the ok that its sender waits for
        return min(self.lines_per_second, 1.0 / (bits / self.baud + self.latency))

    @property
    def classic_jerk(self) -> bool:
        return self.junction_deviation == 0.0


@dataclass(frozen=True, slots=True)
class FirmwareSettings:
    """The firmware that plays the output (``dialect``), and the tables of all that the profile has.

    harmless: commands and macros that move nothing. returns: those that may move, but return to
    the same position and modes. other_tools: those after which a tool prints that the profile has
    no model of; None if its owner has not said. A name may end in ``*``.
    """

    dialect: str = "klipper"
    harmless: tuple[str, ...] = field(default=(), metadata=NAMES)
    returns: tuple[str, ...] = field(default=(), metadata=NAMES)
    other_tools: tuple[str, ...] | None = field(default=None, metadata=NAMES)
    tables: tuple[FirmwareTable, ...] = ()

    def table(self, kind: type[T]) -> T | None:
        """Return the table of that kind, if the profile has it."""
        return next((table for table in self.tables if isinstance(table, kind)), None)

    def own(self, kind: type[T]) -> T:
        """Return the table of the firmware that plays the output; see ``check_needs``."""
        table = self.table(kind)
        assert table is not None
        return table

    @property
    def kind(self) -> type[FirmwareTable]:
        """Return the kind of table that the firmware has."""
        return TABLES[self.dialect]


TABLES: dict[str, type[FirmwareTable]] = {"klipper": KlipperTable, "marlin": MarlinTable}


def load_firmware(table: dict[str, Any]) -> FirmwareSettings:
    """Return ``[firmware]`` with its tables. Raises PrinterError."""
    keys = [each.name for each in fields(FirmwareSettings) if each.name != "tables"]
    known_keys(table, (*keys, *TABLES), "firmware")
    own = {key: value for key, value in table.items() if key in keys}
    settings = checked(FirmwareSettings, own, "firmware")
    tables = (checked(TABLES[k], table[k], f"firmware.{k}") for k in table if k in TABLES)
    return replace(settings, tables=tuple(tables))


def check_needs(firmware: FirmwareSettings, steps_known: bool, source: str = "") -> None:
    """Raise PrinterError if the firmware needs a table that the profile does not have."""
    key = f"firmware.{firmware.dialect}"
    if firmware.dialect not in TABLES:
        raise PrinterError(f"must be one of {', '.join(TABLES)}", "firmware.dialect", source)
    kind = firmware.kind
    if firmware.table(kind) is None:
        raise PrinterError(f"the table is missing: {kind.holds}", key, source)
    if kind.needs_steps and not steps_known:
        raise PrinterError(f"the table is missing: {kind.needs_steps}", "steps", source)
