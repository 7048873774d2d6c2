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
from hframe_post.firmware.klipper.klipper_code import KlipperCode, averaged_shorter, table_of
from hframe_post.firmware.klipper.klipper_motion import KlipperMotion
from hframe_post.model.shapers import Shaping
from hframe_post.printer.firmware_tables import KlipperTable
from hframe_post.stream.types import FileLimits

_LABEL = re.compile(  # Klipper's, and comments that hosts replace by them
    rb"EXCLUDE_OBJECT_START\b.*?\bNAME=([^\s;]+)|EXCLUDE_OBJECT_END\b"
    rb"|;\s*printing object\b(.*)|;\s*stop printing object\b|;MESH:(.*)|;PRINTING_ID:(.*)",
    re.IGNORECASE,
)
# Klipper's and Kalico's own that set no mode, as RESTORE_GCODE_STATE does
OWN_COMMANDS = """
    ACCELEROMETER_DEBUG_READ ACCELEROMETER_DEBUG_WRITE ACCELEROMETER_MEASURE ACCELEROMETER_QUERY
    ACTIVATE_EXTRUDER ANGLE_CALIBRATE ANGLE_CHIP_CALIBRATE ANGLE_DEBUG_READ ANGLE_DEBUG_WRITE
    ATTACH_PROBE AXIS_TWIST_COMPENSATION_CALIBRATE BED_MESH_CALIBRATE BED_MESH_CHECK
    BED_MESH_CLEAR BED_MESH_MAP BED_MESH_OFFSET BED_MESH_OUTPUT BED_MESH_PROFILE
    BED_SCREWS_ADJUST BED_TILT_CALIBRATE BELAY_DISABLE BELAY_ENABLE BELAY_SET_MULTIPLIER
    BELAY_SET_STEPPER BLTOUCH_DEBUG BLTOUCH_STORE CALCULATE_SWITCH_OFFSET CALC_MEASURED_SKEW
    CALIBRATE_LOAD_CELL CALIBRATE_Z CLEAR_PAUSE CLEAR_RETRACTION COLD_EXTRUDE DELTA_ANALYZE
    DELTA_CALIBRATE DETACH_PROBE DISABLE_FILAMENT_WIDTH_LOG DISABLE_FILAMENT_WIDTH_SENSOR
    DUMP_TMC EDDY_CALIBRATE ENABLE_FILAMENT_WIDTH_LOG ENABLE_FILAMENT_WIDTH_SENSOR
    ENDSTOP_PHASE_CALIBRATE EXCLUDE_OBJECT FIRMWARE_RESTART FORCE_MOVE GET_CURRENT_SKEW
    GET_POSITION GET_RETRACTION HELP INIT_TMC LDC_CALIBRATE LOAD_CELL_DIAGNOSTIC LOAD_CELL_READ
    LOAD_CELL_TARE LOAD_CELL_TEST_TAP LOG_ROLLOVER MANUAL_PROBE MANUAL_STEPPER
    MEASURE_AXES_NOISE MOVE_AVOIDING_DOCK MOVE_TO_APPROACH_PROBE MOVE_TO_DETACH_PROBE
    MOVE_TO_DOCK_PROBE MOVE_TO_EXTRACT_PROBE MOVE_TO_INSERT_PROBE MPC_CALIBRATE MPC_SET
    PID_CALIBRATE PID_PROFILE PROBE PROBE_ACCURACY PROBE_CALIBRATE PROBE_EDDY_CURRENT_CALIBRATE
    PROBE_EDDY_CURRENT_TAP_CALIBRATE PROBE_Z_ACCURACY QUAD_GANTRY_LEVEL QUERY_ADC QUERY_BELAY
    QUERY_BUTTON QUERY_DOCKABLE_PROBE QUERY_ENDSTOPS QUERY_FILAMENT_SENSOR QUERY_FILAMENT_WIDTH
    QUERY_PROBE QUERY_RAW_FILAMENT_WIDTH RESET_FILAMENT_WIDTH_SENSOR RESET_RETRACTION
    RESET_SMART_EFFECTOR RESET_VELOCITY_LIMIT RESTART RESTORE_DUAL_CARRIAGE_STATE SAVE_CONFIG
    SAVE_DUAL_CARRIAGE_STATE SAVE_GCODE_STATE SAVE_VARIABLE SCREWS_TILT_CALCULATE
    SDCARD_LOOP_BEGIN SDCARD_LOOP_DESIST SDCARD_LOOP_END SDCARD_RESET_FILE SET_DIGIPOT
    SET_DISPLAY_GROUP SET_DOCKABLE_PROBE SET_DUAL_CARRIAGE SET_EXTRUDER_ROTATION_DISTANCE
    SET_EXTRUDER_STEP_DISTANCE SET_E_ROTATION_DISTANCE SET_GCODE_OFFSET SET_HEATER_PID
    SET_KINEMATICS_LIMIT SET_KINEMATIC_POSITION SET_MIXING_EXTRUDER SET_MIXING_EXTRUDER_GRADIENT
    SET_SERVO SET_SKEW SET_SMART_EFFECTOR SET_SMOOTH_TIME SET_STEPPER_CARRIAGES
    SET_STEPPER_ENABLE SET_STEPPER_PHASE SET_TMC_FIELD SET_Z_THERMAL_ADJUST SHAPER_CALIBRATE
    SKEW_PROFILE STATUS STEPPER_BUZZ SYNC_EXTRUDER_MOTION TAP_CALIBRATE TEMPERATURE_PROBE_ABORT
    TEMPERATURE_PROBE_CALIBRATE TEMPERATURE_PROBE_COMPLETE TEMPERATURE_PROBE_ENABLE
    TEMPERATURE_PROBE_NEXT TEST_RESONANCES TUNING_TOWER TURN_OFF_HEATERS Z_ENDSTOP_CALIBRATE
    Z_OFFSET_APPLY_ENDSTOP Z_OFFSET_APPLY_PROBE Z_TILT_ADJUST Z_TILT_AUTODETECT Z_TILT_CALIBRATE
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
