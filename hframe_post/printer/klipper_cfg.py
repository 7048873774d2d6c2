"""Klipper's printer.cfg: read, and compared with a profile.

Klipper's defaults hold here too: https://www.klipper3d.org/Config_Reference.html
"""

from __future__ import annotations

import configparser
import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from hframe_post.errors import HframeError
from hframe_post.printer.decoding import decoded
from hframe_post.printer.settings import Printer

CLOSE = 1e-3  # tolerated difference of two numbers
AUTOSAVE = "#*# "  # starts each line that SAVE_CONFIG wrote
MAX_DEPTH = 10  # of nested includes
MAX_SIZE = 1 << 22  # bytes
ACCELEROMETERS = ("adxl345", "lis2dw", "lis3dh", "mpu9250", "icm20948", "beacon", "cartographer")


@dataclass(frozen=True, slots=True)
class Finding:
    """A difference from the profile. wrong: the printer would not move as computed."""

    wrong: bool
    text: str


class KlipperConfig:
    """A printer.cfg with its includes. Raises HframeError if it is not a printer.cfg.

    missing: includes that were not found.
    """

    def __init__(self, path: Path) -> None:
        self._parser = configparser.RawConfigParser(
            strict=False, inline_comment_prefixes=("#", ";"), default_section="\0",
            allow_no_value=True, empty_lines_in_values=True,
        )  # fmt: skip
        self.missing: list[str] = []
        self.path = path
        self._read(path, MAX_DEPTH)
        if not self._parser.has_section("printer"):
            lost = f"; {', '.join(self.missing)} was not found" if self.missing else ""
            raise HframeError(
                _advice(path, _text(path))
                or f"{path} has no section [printer]{lost}: is it a printer.cfg?"
            )

    def _read(self, path: Path, depth: int) -> None:
        text = _text(path)
        before = set(self._parser.sections())
        try:
            self._parser.read_string(text, str(path))
        except configparser.Error as error:
            raise HframeError(_advice(path, text) or f"{path}: {_cause(error)}") from None
        except AttributeError:  # raised by configparser for a value before the first key
            raise HframeError(f"{path}: a value begins before its key") from None
        for section in [each for each in self._parser.sections() if each not in before]:
            if section.startswith("include "):
                pattern = section.removeprefix("include ").strip()
                found = sorted(path.parent.glob(pattern)) if pattern[:1] not in "/~" else []
                if not found or not depth:
                    self.missing.append(pattern)
                for each in found if depth else ():
                    self._read(each, depth - 1)

    def has(self, section: str) -> bool:
        return self._parser.has_section(section)

    def macro(self, name: str) -> bool:
        sections = (section.upper().split() for section in self._parser.sections())
        return ["GCODE_MACRO", name.upper()] in sections

    def replaces(self, command: str) -> bool:
        """Return whether a macro takes a command's name and does not call what had it before."""
        return any(
            section.upper().split() == ["GCODE_MACRO", command.upper()]
            and not self.text(section, "rename_existing")
            for section in self._parser.sections()
        )

    def text(self, section: str, key: str, default: str = "") -> str:
        return (self._parser.get(section, key, fallback=None) or default).strip()

    def number(self, section: str, key: str, default: float = math.nan) -> float:
        """Return a value, or the default if there is none. Raises HframeError."""
        text = self.text(section, key)
        if not text:
            return default
        try:
            return float(text)
        except ValueError:
            raise HframeError(f"{self.path}: [{section}] {key}: {text!r} is not a number") from None

    def accelerometers(self) -> list[str]:
        """Return the names by which Klipper's commands know the accelerometers."""
        sections = (section.split() for section in self._parser.sections())
        return [words[-1] for words in sections if words and words[0] in ACCELEROMETERS]

    def step(self, section: str) -> float:
        """Return mm per step of a motor; nan if it cannot be computed."""
        gears = 1.0
        for pair in filter(None, self.text(section, "gear_ratio").split(",")):
            driven, _, driving = pair.partition(":")
            try:
                gears *= float(driven) / float(driving)
            except (ValueError, ZeroDivisionError):
                return math.nan
        steps = self.number(section, "full_steps_per_rotation", 200.0)
        steps *= self.number(section, "microsteps") * gears
        return self.number(section, "rotation_distance") / steps if steps else math.nan


MARLIN = re.compile(r"^\s*(#define\s|(echo:\s*)?M(92|203|205) |/\*\*|// )", re.MULTILINE)
PROFILE = re.compile(r"^\s*(extends\s*=|\[(compensation|plant|travel)\b)", re.MULTILINE)


def _text(path: Path) -> str:
    with path.open("rb") as file:
        content = file.read(MAX_SIZE + 1)
    if len(content) > MAX_SIZE:
        raise HframeError(f"{path} is larger than {MAX_SIZE} bytes: is it a printer.cfg?")
    lines = decoded(content, str(path)).splitlines()
    return "\n".join(line.removeprefix(AUTOSAVE) for line in lines)


def _advice(path: Path, text: str) -> str:
    """Return what to do with a file of another kind; nothing if it is unknown."""
    if PROFILE.search(text):
        return f"{path} is a profile of hframe-post: give Klipper's printer.cfg instead"
    if MARLIN.search(text):
        return (
            f"{path} is of Marlin, which has no printer.cfg: answer the questions of 'hframe-post "
            "printers new -o my.toml'"
        )
    return ""


def _cause(error: configparser.Error) -> str:
    """Return the cause without the file's name, which configparser repeats."""
    number = getattr(error, "lineno", None) or next(iter(getattr(error, "errors", [])), (None,))[0]
    where = f"line {number} " if number else ""
    return f"{where}is neither a [section] nor an option of one: is it a printer.cfg?"


def check(config: KlipperConfig, printer: Printer) -> Iterator[Finding]:
    """Yield the differences of a printer.cfg from a profile. Raises HframeError."""
    for name in config.missing:
        yield Finding(False, f"[include {name}] was not found and is not checked")
    yield from _kinematics(config, printer)
    yield from _steps(config, printer)
    yield from _numbers(config, printer)
    yield from _travel(config, printer)
    yield from _stream(config, printer)


def _kinematics(config: KlipperConfig, printer: Printer) -> Iterator[Finding]:
    has = config.text("printer", "kinematics")
    needs = {"hbot": "corexy"}.get(kind := printer.kinematics.type, kind.replace("-", "_"))
    if has != needs:
        yield Finding(
            True,
            f'[printer] kinematics: {has}; a profile with kinematics.type = "{kind}" needs {needs}',
        )


def _repeated(config: KlipperConfig, printer: Printer) -> list[tuple[str, float, str, str, float]]:
    """Return the numbers of the profile that printer.cfg has too.

    Each is a key of the profile, its value, a section, an option and its default.
    """
    klipper, limits = printer.firmware.klipper, printer.limits
    velocity = config.number("printer", "max_velocity")
    acceleration = config.number("printer", "max_accel")
    pairs = [("limits.z_velocity", limits.z_velocity, "printer", "max_z_velocity", velocity),
        ("limits.z_acceleration", limits.z_acceleration, "printer", "max_z_accel", acceleration),
        ("limits.extruder_velocity", limits.extruder_velocity,
         "extruder", "max_extrude_only_velocity", math.nan),
        ("limits.extruder_acceleration", limits.extruder_acceleration,
         "extruder", "max_extrude_only_accel", math.nan),
        ("limits.extruder_corner_velocity", limits.extruder_corner_velocity,
         "extruder", "instantaneous_corner_velocity", 1.0),
    ]  # fmt: skip
    if klipper is not None and not klipper.end_macro:
        table = "firmware.klipper"
        pairs += [
            (f"{table}.velocity", klipper.velocity, "printer", "max_velocity", math.nan),
            (f"{table}.acceleration", klipper.acceleration, "printer", "max_accel", math.nan),
            (f"{table}.square_corner_velocity", klipper.square_corner_velocity,
             "printer", "square_corner_velocity", 5.0),
            (f"{table}.minimum_cruise_ratio", klipper.minimum_cruise_ratio,
             "printer", "minimum_cruise_ratio", 0.5),
            (f"{table}.shaper_freq_x", klipper.shaper_freq_x, "input_shaper", "shaper_freq_x", 0.0),
            (f"{table}.shaper_freq_y", klipper.shaper_freq_y, "input_shaper", "shaper_freq_y", 0.0),
        ]  # fmt: skip
    if (retraction := printer.retraction) is not None:
        back = retraction.return_speed or retraction.speed
        pairs += [
            ("retraction.length", retraction.length, "firmware_retraction", "retract_length", 0.0),
            ("retraction.speed", retraction.speed, "firmware_retraction", "retract_speed", 20.0),
            ("retraction.return_speed", back, "firmware_retraction", "unretract_speed", 10.0),
            ("retraction.extra", retraction.extra,
             "firmware_retraction", "unretract_extra_length", 0.0),
        ]  # fmt: skip
    return pairs


def _numbers(config: KlipperConfig, printer: Printer) -> Iterator[Finding]:
    for key, wanted, section, option, default in _repeated(config, printer):
        has = config.number(section, option, default)
        if math.isnan(has):
            yield Finding(
                False,
                f"[{section}] {option} is missing, so Klipper chooses it: add the line "
                f"'{option}: {wanted:g}', the profile's {key}",
            )
        elif not math.isclose(has, wanted, rel_tol=CLOSE, abs_tol=1e-9):
            given = "" if config.text(section, option) else " (by default)"
            yield Finding(True, f"[{section}] {option}: {has:g}{given}, but {key} = {wanted:g}")


def _steps(config: KlipperConfig, printer: Printer) -> Iterator[Finding]:
    expected = printer.steps.belt if printer.steps is not None else math.nan
    for motor in ("stepper_x", "stepper_y") if printer.steps is not None else ():
        step = config.step(motor)
        if not math.isnan(step) and not math.isclose(step, expected, rel_tol=0.01):
            text = (
                f"[{motor}] steps are of {step:.5g} mm, the profile's steps.belt is {expected:.5g}"
            )
            yield Finding(True, text)


def _travel(config: KlipperConfig, printer: Printer) -> Iterator[Finding]:
    for axis in "xyz":
        low, high = getattr(printer.travel, axis)
        least = config.number(f"stepper_{axis}", "position_min", 0.0)
        most = config.number(f"stepper_{axis}", "position_max")
        for end, bound, inside in (
            (low, f"position_min: {least:g}", low >= least - CLOSE),
            (high, f"position_max: {most:g}", not high > most + CLOSE),
        ):
            if math.isfinite(end) and not inside:
                yield Finding(
                    True, f"[stepper_{axis}] {bound}, but travel.{axis} reaches to {end:g}"
                )


def _stream(config: KlipperConfig, printer: Printer) -> Iterator[Finding]:
    klipper = printer.firmware.klipper
    for name in (klipper.begin_macro, klipper.end_macro) if klipper is not None else ():
        if name and not config.macro(name):
            yield Finding(True, f"[gcode_macro {name}] is missing; firmware.klipper names it")
    if config.text("printer", "max_accel_to_decel"):
        yield Finding(
            False,
            "[printer] max_accel_to_decel belongs to an older Klipper: converted files need "
            "MINIMUM_CRUISE_RATIO, of March 2024 or newer",
        )
    if config.has("skew_correction"):
        yield Finding(False, "[skew_correction] distorts the converted motion: turn it off")
    if not config.macro("CANCEL_PRINT"):
        yield Finding(
            False,
            "[gcode_macro CANCEL_PRINT] is missing: after a cancelled print the limits of the "
            "converted file stay in force. Run 'hframe-post klipper-macros' (docs/klipper.md)",
        )
