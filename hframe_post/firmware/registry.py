"""The firmwares that the output can be written for. architecture.md says how to add one.

Marlin's parts are imported where they are needed: a slicer waits, and most printers run Klipper.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from hframe_post.errors import PrinterError
from hframe_post.firmware.base import (
    UNLIMITED_DEVIATION,
    Firmware,
    FirmwareLimits,
    Source,
    unlimited,
)
from hframe_post.firmware.dialect import (
    Accelerations,
    Advance,
    Dialect,
    Words,
    klipper_advance,
    klipper_seconds,
    marlin_advance,
    object_label,
)
from hframe_post.firmware.klipper.klipper_stream import (
    KlipperCode,
    KlipperMotion,
    averaged_shorter,
)
from hframe_post.model.shapers import Shaping
from hframe_post.printer.firmware_tables import KlipperTable, MarlinTable, check_needs
from hframe_post.printer.settings import Limits, Printer
from hframe_post.stream.types import FileLimits

if TYPE_CHECKING:
    from hframe_post.firmware.marlin.marlin_code import MarlinCode
    from hframe_post.firmware.marlin.marlin_motion import MarlinMotion, MarlinMoves

# ---------------------------------------------------------------------- Klipper

_LABEL = re.compile(  # Klipper's, and comments that hosts replace by them
    rb"EXCLUDE_OBJECT_START\b.*?\bNAME=([^\s;]+)|EXCLUDE_OBJECT_END\b"
    rb"|;\s*printing object\b(.*)|;\s*stop printing object\b|;MESH:(.*)|;PRINTING_ID:(.*)",
    re.IGNORECASE,
)
# how names of Klipper's own commands begin that sliced files have; none of them sets a mode
OWN_COMMANDS = (
    "ACCELEROMETER_", "BED_", "CLEAR_PAUSE", "GET_", "PROBE", "QUAD_", "QUERY_", "SAVE_", "SCREWS_",
    "SET_", "SKEW_", "SYNC_", "TUNING_", "TURN_OFF_", "Z_",
)  # fmt: skip


def _lower_of_p_and_t(words: Words, before: Accelerations) -> Accelerations:
    """Return S, or the lower of P and T if both are given, for every move."""
    if "S" in words:
        return words["S"], words["S"]
    both = min(words["P"], words["T"]) if {"P", "T"} <= words.keys() else before[0]
    return both, both


def _object_label(text: bytes) -> bytes | None:
    """Return the object that a line says begins; see ``Dialect``."""
    if (match := _LABEL.match(text.lstrip())) is None:
        return object_label(text)
    return match[match.lastindex] if match.lastindex else b""


def _may_be_macro(name: str) -> bool:
    """Return whether Klipper allows a macro of this name, and has no command of its own by it."""
    legal = name.isascii() and name.replace("_", "A").isalnum() and not name[1:2].isdigit()
    return legal and not name.startswith(OWN_COMMANDS)


class Klipper(Firmware):
    """Klipper."""

    name, table = "klipper", KlipperTable
    dialect = Dialect(
        frozenset({"M204", "SET_VELOCITY_LIMIT"}), _lower_of_p_and_t,
        retraction_settings=frozenset({"SET_RETRACTION"}), g92_resets=True,
        label=_object_label, may_be_macro=_may_be_macro, advance=klipper_advance,
    )  # fmt: skip
    decimates = True
    shapers = ("zv", "mzv", "ei", "2hump_ei", "3hump_ei")
    newer_versions = "Klipper of 27 April 2026 or newer"
    configuration = "printer.cfg"

    def motion(self, tolerance: float | None) -> KlipperMotion:
        code, corner = self.code(), self.printer.limits.square_corner_velocity
        return KlipperMotion(code.table, code.stream, tolerance, corner)

    def code(self) -> KlipperCode:
        return KlipperCode.from_printer(self.printer)

    def advance(self) -> Advance:
        if (extruder := averaged_shorter(self.printer.extruder)) is None:
            return super().advance()
        return Advance(extruder.advance, extruder.stream_smooth_time, klipper_seconds)

    def limits(self) -> FirmwareLimits:
        table = self.printer.firmware.own(KlipperTable)
        own, usual = unlimited(self.printer.limits), table.acceleration
        others = FileLimits(
            path=table.velocity, cruise_ratio=table.minimum_cruise_ratio, belts=self.belts
        )
        return FirmwareLimits(own, usual, usual, table.square_corner_velocity, others)

    def most(self) -> tuple[float, float]:
        table = self.printer.firmware.own(KlipperTable)
        return table.velocity, table.acceleration

    @staticmethod
    def shaper_settings(shaping: Shaping) -> str:
        lines = ["[input_shaper]"]
        for axis, chosen in (("x", shaping.x), ("y", shaping.y)):
            lines += [
                f"shaper_type_{axis}: {chosen.name}",
                f"shaper_freq_{axis}: {chosen.hz:.1f}",
                f"damping_ratio_{axis}: {chosen.damping:.3f}",
            ]
        return "\n".join(lines)

    @classmethod
    def source(cls, files: Sequence[Path]) -> Source:
        from hframe_post.firmware.klipper.source import KlipperSource

        return KlipperSource(files[0])


# ---------------------------------------------------------------------- Marlin


def _p_and_t(words: Words, before: Accelerations) -> Accelerations:
    """Return P for printing and T for travel, or S for both."""
    if "S" in words:
        return words["S"], words["S"]
    return words.get("P", before[0]), words.get("T", before[1])


def _dwell(words: Words) -> float:
    """Return the seconds of S, or those of P, which is in ms, where S is missing."""
    return words["S"] if "S" in words else words.get("P", 0.0) / 1000.0


# limits of a profile that hold until the file sets others: M203, M201 and M204 R
Z_AND_E = dict.fromkeys(
    ("z_velocity", "z_acceleration", "extruder_velocity", "extruder_acceleration"), math.inf
)


class Marlin(Firmware):
    """Marlin."""

    name, table = "marlin", MarlinTable
    dialect = Dialect(
        frozenset({"M201", "M203", "M204", "M205"}), _p_and_t, _dwell,
        retraction_settings=frozenset({"M207", "M208"}), g90_sets_e=True, saves_factor=True,
        ignores_zero_feed=True, splines=True, cr_ends_lines=True,
        advance=marlin_advance,
    )  # fmt: skip
    configuration = "m503.txt"

    def motion(self, tolerance: float | None) -> MarlinMotion:
        """Return its motion. tolerance: not used, segments are as long as whole steps make them."""
        from hframe_post.firmware.marlin.marlin_motion import MarlinMotion

        return MarlinMotion(self.code(), self.printer.kinematics)

    def code(self) -> MarlinCode:
        from hframe_post.firmware.marlin.marlin_code import MarlinCode

        return MarlinCode.from_printer(self.printer)

    def reads(self) -> Dialect:
        """Return what its build reads: one with junction deviation ignores M205 X and Y."""
        table = self.printer.firmware.own(MarlinTable)
        return replace(
            self.dialect, has_deviation=not table.classic_jerk, soft_endstops=table.soft_endstops
        )

    def moves(self) -> MarlinMoves:
        from hframe_post.firmware.marlin.marlin_motion import MarlinMoves

        return MarlinMoves.on(self.code(), self.printer.kinematics)

    def advance(self) -> Advance:
        stored = self.printer.firmware.own(MarlinTable).linear_advance
        return Advance.of_extruder(self.printer.extruder, marlin_advance, stored)

    def limits(self) -> FirmwareLimits:
        table = self.printer.firmware.own(MarlinTable)
        (v_x, v_y), (a_x, a_y) = table.max_velocity, table.max_acceleration
        own, corner, deviation, known = self.printer.limits, min(table.jerk), math.inf, math.inf
        if not table.classic_jerk:  # such a board knows no other rule, whatever the file says
            corner, deviation, known = math.inf, table.junction_deviation, UNLIMITED_DEVIATION
        others = FileLimits(
            (v_x, v_y, own.z_velocity, own.extruder_velocity),
            (a_x, a_y, own.z_acceleration, table.max_acceleration_e or math.inf),
            retract=own.extruder_acceleration, deviation=deviation, belts=self.belts,
        )  # fmt: skip
        return FirmwareLimits(
            replace(unlimited(own, known), **Z_AND_E), table.acceleration,
            table.travel_acceleration, corner, others, (code := self.code()).durations,
            (code.steps.belt, code.steps.belt, code.steps.z, code.steps.e),
            table.min_steps_per_segment, code.brakes_late,
        )  # fmt: skip

    def caps(self) -> Limits:
        return replace(super().caps(), **Z_AND_E)

    @staticmethod
    def shaper_settings(shaping: Shaping) -> str:
        lines = ["; for Marlin 2.1.2 or newer with INPUT_SHAPING_X and INPUT_SHAPING_Y"]
        for axis, chosen in (("X", shaping.x), ("Y", shaping.y)):
            lines.append(f"M593 {axis} F{chosen.hz:.1f} D{chosen.damping:.3f}")
        return "\n".join([*lines, "M500 ; saves it"])

    @classmethod
    def source(cls, files: Sequence[Path]) -> Source | None:
        from hframe_post.firmware.marlin.m503 import is_of_marlin, text_in
        from hframe_post.firmware.marlin.marlin_source import MarlinSource

        return MarlinSource(files) if is_of_marlin(text_in(files[0])) else None

    def check_serial(self) -> None:
        if not self.printer.firmware.own(MarlinTable).baud:
            raise PrinterError(
                "OctoPrint prints over a serial line, which starves without it and makes prints "
                "worse. Write the speed of the connection below [firmware.marlin], such as "
                "'baud = 115200' (docs/firmware.md)",
                "firmware.marlin.baud", self.printer.name,
            )  # fmt: skip


# ----------------------------------------------------------------------
# The firmware of a printer, and of the files that describe one.

FIRMWARES: dict[str, type[Firmware]] = {each.name: each for each in (Klipper, Marlin)}


def firmware(printer: Printer) -> Firmware:
    """Return the firmware that a printer names. Raises PrinterError: a library's may lack it."""
    check_needs(printer.firmware, printer.steps is not None, printer.name)
    return FIRMWARES[printer.firmware.dialect](printer)


def source_of(files: Sequence[Path]) -> Source:
    """Return what the files of a firmware say of a printer. Raises HframeError.

    Klipper is asked last: it takes all files, and says what is wrong with those of no firmware.
    """
    sources = (FIRMWARES[name].source(files) for name in reversed([*FIRMWARES]))
    return next(source for source in sources if source is not None)
