"""Klipper as a firmware: what it reads, and where its parts are."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path

from hframe_post.firmware.advance import Advance, klipper_advance, klipper_seconds
from hframe_post.firmware.base import Firmware, FirmwareLimits, unlimited
from hframe_post.firmware.configuration import Finding, Source
from hframe_post.firmware.dialect import Accelerations, Dialect, Words, object_label
from hframe_post.firmware.klipper.code import KlipperCode, averaged_shorter, table_of
from hframe_post.firmware.klipper.motion import KlipperMotion
from hframe_post.model.shapers import Shaping
from hframe_post.printer.firmware_tables import KlipperTable
from hframe_post.stream.types import FileLimits

_LABEL = re.compile(  # Klipper's, and comments that hosts replace by them
    rb"EXCLUDE_OBJECT_START\b.*?\bNAME=([^\s;]+)|EXCLUDE_OBJECT_END\b"
    rb"|;\s*printing object\b(.*)|;\s*stop printing object\b|;MESH:(.*)|;PRINTING_ID:(.*)",
    re.IGNORECASE,
)
# Klipper's own that set no mode, as RESTORE_GCODE_STATE does
OWN_COMMANDS = """
    ACCELEROMETER_DEBUG_READ ACCELEROMETER_DEBUG_WRITE ACCELEROMETER_MEASURE
    ACCELEROMETER_QUERY ACTIVATE_EXTRUDER ANGLE_CALIBRATE ANGLE_CHIP_CALIBRATE
    AXIS_TWIST_COMPENSATION_CALIBRATE BED_MESH_CALIBRATE BED_MESH_CHECK BED_MESH_CLEAR
    BED_MESH_MAP BED_MESH_OFFSET BED_MESH_OUTPUT BED_MESH_PROFILE BED_SCREWS_ADJUST
    BED_TILT_CALIBRATE BLTOUCH_DEBUG BLTOUCH_STORE CALC_MEASURED_SKEW CLEAR_PAUSE
    CLEAR_RETRACTION DELTA_ANALYZE DELTA_CALIBRATE DUMP_TMC ENDSTOP_PHASE_CALIBRATE
    EXCLUDE_OBJECT FIRMWARE_RESTART FORCE_MOVE GET_CURRENT_SKEW GET_POSITION GET_RETRACTION
    HELP INIT_TMC LOG_ROLLOVER MANUAL_PROBE MANUAL_STEPPER MEASURE_AXES_NOISE MPC_CALIBRATE
    MPC_SET PID_CALIBRATE PID_PROFILE PROBE PROBE_ACCURACY PROBE_CALIBRATE QUAD_GANTRY_LEVEL
    QUERY_ADC QUERY_BUTTON QUERY_ENDSTOPS QUERY_FILAMENT_SENSOR QUERY_FILAMENT_WIDTH
    QUERY_PROBE RESET_RETRACTION RESET_SMART_EFFECTOR RESET_VELOCITY_LIMIT RESTART SAVE_CONFIG
    SAVE_GCODE_STATE SAVE_VARIABLE SCREWS_TILT_CALCULATE SDCARD_LOOP_BEGIN SDCARD_LOOP_DESIST
    SDCARD_LOOP_END SET_DIGIPOT SET_DUAL_CARRIAGE SET_EXTRUDER_ROTATION_DISTANCE
    SET_EXTRUDER_STEP_DISTANCE SET_GCODE_OFFSET SET_HEATER_PID SET_KINEMATICS_LIMIT
    SET_KINEMATIC_POSITION SET_MIXING_EXTRUDER SET_SERVO SET_SKEW SET_SMART_EFFECTOR
    SET_SMOOTH_TIME SET_STEPPER_CARRIAGES SET_STEPPER_ENABLE SET_STEPPER_PHASE SET_TMC_FIELD
    SET_Z_THERMAL_ADJUST SHAPER_CALIBRATE SKEW_PROFILE STATUS STEPPER_BUZZ
    SYNC_EXTRUDER_MOTION TEST_RESONANCES TUNING_TOWER TURN_OFF_HEATERS Z_ENDSTOP_CALIBRATE
    Z_OFFSET_APPLY_ENDSTOP Z_OFFSET_APPLY_PROBE Z_TILT_ADJUST
"""
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


def _may_set_modes(name: str) -> bool:
    """Return whether a command may set modes: a macro may, Klipper's own commands do not."""
    coded = name[:1] in "GMT" and name[1:].isdigit()
    return not (coded or name in OWN_COMMANDS.split())


def _dwell(words: Words) -> float:
    """Return P, which is in ms; S means nothing."""
    return words.get("P", 0.0) / 1000.0


class Klipper(Firmware):
    """Klipper."""

    name, table = "klipper", KlipperTable
    dialect = Dialect(
        frozenset({"M204", "SET_VELOCITY_LIMIT"}), _accelerations, _dwell,
        retraction_settings=frozenset({"SET_RETRACTION"}), g92_resets=True,
        label=_object_label, may_set_modes=_may_set_modes, advance=klipper_advance,
    )  # fmt: skip
    decimates = True
    shapers = SHAPERS
    newer_versions = "Klipper of 27 April 2026 or newer"
    configuration = compared = "printer.cfg"
    unchecked = "printer.cfg is not checked: name it with --printer-cfg"

    def motion(self, tolerance: float | None, retract_moving: bool = False) -> KlipperMotion:
        code, corner = self.code(), self.printer.limits.square_corner_velocity
        return KlipperMotion(code.table, code.stream, tolerance, corner, retract_moving)

    def code(self) -> KlipperCode:
        return KlipperCode.from_printer(self.printer)

    def advance(self) -> Advance:
        if (extruder := averaged_shorter(self.printer.extruder)) is None:
            return super().advance()
        return Advance(extruder.advance, extruder.stream_smooth_time, klipper_seconds)

    def limits(self) -> FirmwareLimits:
        table = table_of(self.printer)
        own, usual = unlimited(self.printer.limits), table.acceleration
        others = FileLimits(
            path=table.velocity, cruise_ratio=table.minimum_cruise_ratio, belts=self.belts
        )
        return FirmwareLimits(own, usual, usual, table.square_corner_velocity, others)

    def most(self) -> tuple[float, float]:
        table = table_of(self.printer)
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

    def host_findings(self, config: Path, log: Path | None, remedy: str) -> Iterator[Finding]:
        from hframe_post.firmware.klipper.macro_check import check_macros
        from hframe_post.firmware.klipper.printer_cfg import KlipperConfig
        from hframe_post.firmware.klipper.version import check_version

        read = KlipperConfig(config)
        yield from check_macros(read, self.printer, remedy)
        yield from check_version(read, log)
