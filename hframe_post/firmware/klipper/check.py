"""Klipper's printer.cfg compared with a profile.

Klipper's defaults hold here too: https://www.klipper3d.org/Config_Reference.html
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from typing import NamedTuple

from hframe_post.firmware.configuration import Finding
from hframe_post.firmware.klipper.live import klipper_name
from hframe_post.firmware.klipper.printer_cfg import KlipperConfig
from hframe_post.firmware.klipper.settings import extruder
from hframe_post.printer.firmware_tables import END_MACRO, MACROS
from hframe_post.printer.new_profile import Known, as_float
from hframe_post.printer.settings import SMOOTH_TIME_S, Printer

CLOSE = 1e-3  # tolerated difference of two numbers
SHAPES = re.compile(r"^\s*SET_INPUT_SHAPER\b[^\n]*SHAPER_FREQ", re.MULTILINE | re.IGNORECASE)


class ConfigDifference(NamedTuple):
    """A difference of printer.cfg from the profile, and whether it is wrong."""

    wrong: bool
    section: str
    option: str
    text: str


def check(config: KlipperConfig, printer: Printer, remedy: str) -> Iterator[Finding]:
    """Yield the differences of a printer.cfg from a profile. Raises HframeError.

    remedy: what to do where they differ.
    """
    if config.unsaved:
        yield Finding(True, config.unsaved)
    for wrong, section, option, text in (
        *_kinematics(config, printer),
        *_steps(config, printer),
        *_numbers(config, printer),
        *_travel(config, printer),
    ):
        where = f"{config.place(section, option)}: [{section}] {text}"
        yield Finding(wrong, f"{where}: {remedy}" if wrong else where)
    yield from _stream(config, printer)
    for warning in warnings(config):
        yield Finding(False, warning)


def _kinematics(config: KlipperConfig, printer: Printer) -> Iterator[ConfigDifference]:
    has = config.text("printer", "kinematics")
    needs = klipper_name(kind := printer.kinematics.type)
    if has != needs:
        text = f'kinematics: {has}; a profile with kinematics.type = "{kind}" needs {needs}'
        yield ConfigDifference(True, "printer", "kinematics", text)


def _speed_and_acceleration(config: KlipperConfig) -> tuple[float, float]:
    return config.number("printer", "max_velocity"), config.number("printer", "max_accel")


def _repeated(config: KlipperConfig, printer: Printer) -> list[tuple[str, float, str, str, float]]:
    """Return the numbers of the profile that printer.cfg has too.

    Each is a key of the profile, its value, a section, an option and its default.
    """
    klipper, limits = printer.firmware.klipper, printer.limits
    velocity, acceleration = _speed_and_acceleration(config)
    filament = extruder(config, Known(velocity, ""), Known(acceleration, ""))
    pairs = [("limits.z_velocity", limits.z_velocity, "printer", "max_z_velocity", velocity),
        ("limits.z_acceleration", limits.z_acceleration, "printer", "max_z_accel", acceleration),
        ("limits.extruder_velocity", limits.extruder_velocity,
         "extruder", "max_extrude_only_velocity", as_float(filament["extruder_velocity"])),
        ("limits.extruder_acceleration", limits.extruder_acceleration,
         "extruder", "max_extrude_only_accel", as_float(filament["extruder_acceleration"])),
        ("limits.extruder_corner_velocity", limits.extruder_corner_velocity,
         "extruder", "instantaneous_corner_velocity", 1.0),
    ]  # fmt: skip
    if klipper is not None:
        table = "firmware.klipper"
        pairs += [
            (f"{table}.velocity", klipper.velocity, "printer", "max_velocity", math.nan),
            (f"{table}.acceleration", klipper.acceleration, "printer", "max_accel", math.nan),
            (f"{table}.square_corner_velocity", klipper.square_corner_velocity,
             "printer", "square_corner_velocity", 5.0),
            (f"{table}.minimum_cruise_ratio", klipper.minimum_cruise_ratio,
             "printer", "minimum_cruise_ratio", config.cruise_ratio()),
        ]  # fmt: skip
        keys = [f"shaper_freq_{axis}" for axis in "xyz"]
        pairs += [
            (f"{table}.{key}", getattr(klipper, key), "input_shaper", key, 0.0) for key in keys
        ]
    if (retraction := printer.retraction) is not None:
        back = retraction.return_speed or retraction.speed
        pairs += [
            ("retraction.length", retraction.length, "firmware_retraction", "retract_length", 0.0),
            ("retraction.speed", retraction.speed, "firmware_retraction", "retract_speed", 20.0),
            ("retraction.return_speed", back, "firmware_retraction", "unretract_speed", 10.0),
            ("retraction.extra", retraction.extra,
             "firmware_retraction", "unretract_extra_length", 0.0),
        ]  # fmt: skip
    if (extrudes := printer.extruder) is not None:
        pairs += [
            ("extruder.advance", extrudes.advance, "extruder", "pressure_advance", 0.0),
            ("extruder.smooth_time", extrudes.smooth_time,
             "extruder", "pressure_advance_smooth_time", SMOOTH_TIME_S),
        ]  # fmt: skip
    return pairs


def _numbers(config: KlipperConfig, printer: Printer) -> Iterator[ConfigDifference]:
    for key, wanted, section, option, default in _repeated(config, printer):
        has = config.number(section, option, default)
        if config.missing and not config.text(section, option):
            continue  # a file that was not found may set it
        if math.isnan(has):
            line = f"'{option}: {wanted:g}', the profile's {key}"
            text = f"has no {option}, so Klipper chooses it: add {line}"
            yield ConfigDifference(False, section, option, text)
        elif not math.isclose(has, wanted, rel_tol=CLOSE, abs_tol=1e-9):
            given = "" if config.text(section, option) else " (by default)"
            text = f"{option}: {has:g}{given}, but {key} = {wanted:g}"
            yield ConfigDifference(True, section, option, text)


def _steps(config: KlipperConfig, printer: Printer) -> Iterator[ConfigDifference]:
    expected = printer.steps.belt if printer.steps is not None else math.nan
    for motor in ("stepper_x", "stepper_y") if printer.steps is not None else ():
        step = config.step(motor)
        if not math.isnan(step) and not math.isclose(step, expected, rel_tol=0.01):
            text = f"steps are of {step:.5g} mm, the profile's steps.belt is {expected:.5g}"
            yield ConfigDifference(True, motor, "rotation_distance", text)


def _travel(config: KlipperConfig, printer: Printer) -> Iterator[ConfigDifference]:
    for axis in "xyz":
        low, high = getattr(printer.travel, axis)
        section = f"stepper_{axis}"
        least = config.number(section, "position_min", 0.0)
        most = config.number(section, "position_max")
        for end, option, bound, inside in (
            (low, "position_min", least, low >= least - CLOSE),
            (high, "position_max", most, not high > most + CLOSE),
        ):
            if math.isfinite(end) and not inside:
                text = f"{option}: {bound:g}, but travel.{axis} reaches to {end:g}"
                yield ConfigDifference(True, section, option, text)


def _stream(config: KlipperConfig, printer: Printer) -> Iterator[Finding]:
    klipper = printer.firmware.klipper
    for name in (klipper.begin_macro, klipper.end_macro) if klipper is not None else ():
        if name and name != END_MACRO and not config.macros(name):  # see `check_macros`
            yield Finding(True, f"[gcode_macro {name}] is missing; firmware.klipper names it")
    if config.text("printer", "max_accel_to_decel"):
        place = config.place("printer", "max_accel_to_decel")
        yield Finding(
            False,
            f"{place}: [printer] max_accel_to_decel belongs to an older Klipper: converted files "
            "need MINIMUM_CRUISE_RATIO, of March 2024 or newer",
        )
    if config.has("skew_correction"):
        place = config.place("skew_correction", "")
        yield Finding(False, f"{place}: [skew_correction] distorts converted motion: turn it off")


def warnings(config: KlipperConfig) -> Iterator[str]:
    """Yield what the owner of a printer.cfg must know, whatever the profile says."""
    yield from config.missing
    for section in config.sections("dual_carriage"):
        yield (
            f"{config.place(section, '')}: [{section}]: a profile has the model of one carriage: "
            "what the other prints, after T1, is not compensated"
        )
    for section in config.sections("toolchanger", "tool")[:1]:
        yield (
            f"{config.place(section, '')}: [{section}]: a profile has the model of one tool head, "
            "and others ring differently: list their commands below [firmware] of the profile, as "
            'other_tools = ["T1", "T2"], and what they print is not compensated'
        )
    for section in config.sections("gcode_macro", "delayed_gcode"):
        line = config.lines(section, "gcode")
        if line and line[-1].path.name != MACROS and SHAPES.search(config.text(section, "gcode")):
            yield (
                f"{line[-1].place}: [{section}] runs SET_INPUT_SHAPER: what it sets lasts until a "
                "converted file begins, which restores the frequencies of [input_shaper] at its end"
            )
