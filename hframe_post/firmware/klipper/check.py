"""Klipper's printer.cfg compared with a profile.

Klipper's defaults hold here too: https://www.klipper3d.org/Config_Reference.html
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from hframe_post.errors import one_line
from hframe_post.firmware.base import Finding
from hframe_post.firmware.klipper.live import klipper_name
from hframe_post.firmware.klipper.printer_cfg import KlipperConfig
from hframe_post.firmware.klipper.settings import extruder, warnings
from hframe_post.printer.firmware_tables import END_MACRO
from hframe_post.printer.new_profile import Known, as_float
from hframe_post.printer.settings import SMOOTH_TIME_S, Printer

RELATIVE_DIFFERENCE = 1e-3  # tolerated difference of two numbers


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
        elif not math.isclose(has, wanted, rel_tol=RELATIVE_DIFFERENCE, abs_tol=1e-9):
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
            (low, "position_min", least, low >= least - RELATIVE_DIFFERENCE),
            (high, "position_max", most, not high > most + RELATIVE_DIFFERENCE),
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


# ----------------------------------------------------------------------
# Klipper's version, as its log shows it, and what is wrong with some versions.
#
# Klipper asks git for its version: "v0.13.0-635-g460ee7834", the last release, the commits since,
# and
# the last of these; only that one if the copy of its history has no releases; "-dirty" at the end
# if
# files were changed. No G-code and no macro can read it.

LOG = "klippy.log"
VERSION = re.compile(rb"Git version: '([^']+)'")  # at each start, and where a new log begins
NAMED = re.compile(r"v([\d.]+)-(\d+)-g[0-9a-f]+")
COMMIT = re.compile(r"(?:^|-g)([0-9a-f]{7,40})(?:-dirty)?$")
# Of Klipper's main branch, db10e92e9 to 2239041df: a frequency in SET_INPUT_SHAPER changes nothing
RELEASE, SINCE = "0.13.0", range(631, 642)
AFFECTED = (
    "db10e92e9b3a", "7c0ee842c48c", "19da13507a12", "530cd0512210", "ef8edf3aef7f", "293e1e9d5882",
    "352bc8b2e384", "460ee78340a5", "ef7b13b1f2d4", "d2aa4bd7e371", "2239041df6a2",
)  # fmt: skip
HARM = (
    "ignores SET_INPUT_SHAPER SHAPER_FREQ_X=0, so input shaping stays on in converted files and "
    "moves the motors by up to 0.4 mm"
)
WHICH = f"Klipper of 27 April to 4 May 2026 (v{RELEASE}-{SINCE[0]} to -{SINCE[-1]})"


def log_of(config: Path) -> Path | None:
    """Return the log of the Klipper that reads a printer.cfg, if it is at a usual place."""
    folder = config.absolute().parent
    places = (folder / LOG, folder.parent / "logs" / LOG)
    return next((path for path in places if path.is_file()), None)


def check_version(config: KlipperConfig, log: Path | None) -> Iterator[Finding]:
    """Yield what Klipper's version means for converted files on a printer that shapes its input.

    Raises OSError if the log cannot be read.
    """
    axes = [f"shaper_freq_{axis}" for axis in "xyz"]
    if not config.missing and not any(config.number("input_shaper", a, 0.0) for a in axes):
        return  # nothing needs to be turned off
    version = _last_version(log) if log is not None else ""
    if not version:
        where = (
            f"{log} does not show Klipper's version" if log else "Klipper's version is not known"
        )
        yield Finding(False, f"{where}: show its log with --klippy-log, since {WHICH} {HARM}")
    elif is_affected(version):
        yield Finding(True, f"{log}: Klipper {one_line(version)} {HARM}: update Klipper")


def is_affected(version: str) -> bool:
    """Return whether this version of Klipper cannot turn input shaping off."""
    commit, named = COMMIT.search(version), NAMED.match(version)
    if commit and any(each.startswith(commit[1][:12]) for each in AFFECTED):
        return True
    return bool(named and named[1] == RELEASE and int(named[2]) in SINCE)


def _last_version(log: Path) -> str:
    found = ""
    with log.open("rb") as lines:
        for line in lines:
            if match := VERSION.search(line):
                found = match[1].decode("utf-8", "replace")
    return found
