"""Klipper as a firmware: what it reads, and where its parts are."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from hframe_post.firmware.base import Firmware, FirmwareLimits, Source, unlimited
from hframe_post.firmware.dialect import (
    Accelerations,
    Advance,
    Dialect,
    Words,
    klipper_advance,
    klipper_seconds,
    object_label,
)
from hframe_post.firmware.klipper.klipper_stream import (
    KlipperCode,
    KlipperMotion,
    averaged_shorter,
)
from hframe_post.model.shapers import Shaping
from hframe_post.printer.firmware_tables import KlipperTable
from hframe_post.stream.types import FileLimits

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
SHAPERS = ("zv", "mzv", "ei", "2hump_ei", "3hump_ei")


def _accelerations(words: Words, before: Accelerations) -> Accelerations:
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
        frozenset({"M204", "SET_VELOCITY_LIMIT"}), _accelerations,
        retraction_settings=frozenset({"SET_RETRACTION"}), g92_resets=True,
        label=_object_label, may_be_macro=_may_be_macro, advance=klipper_advance,
    )  # fmt: skip
    decimates = True
    shapers = SHAPERS
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
