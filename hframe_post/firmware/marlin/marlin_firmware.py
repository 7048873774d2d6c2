"""Marlin as a firmware: what it reads, and where its parts are.

These are imported where they are needed: most printers run Klipper.
"""

from __future__ import annotations

import math
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
from hframe_post.firmware.dialect import Accelerations, Advance, Dialect, Words, marlin_advance
from hframe_post.model.shapers import Shaping
from hframe_post.printer.firmware_tables import MarlinTable
from hframe_post.printer.settings import Limits
from hframe_post.stream.types import FileLimits

if TYPE_CHECKING:
    from hframe_post.firmware.marlin.marlin_code import MarlinCode
    from hframe_post.firmware.marlin.marlin_motion import MarlinMotion, MarlinMoves


def _accelerations(words: Words, before: Accelerations) -> Accelerations:
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
        frozenset({"M201", "M203", "M204", "M205"}), _accelerations, _dwell,
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
