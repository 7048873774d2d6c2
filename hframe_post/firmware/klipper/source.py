"""What printer.cfg says: the settings of a profile, and what does not go with one."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path

from hframe_post.errors import HframeError
from hframe_post.firmware.base import Source
from hframe_post.firmware.klipper.live import check_live
from hframe_post.firmware.klipper.macros import FILE, check_macros, macros
from hframe_post.firmware.klipper.printer_cfg import KINEMATICS, KlipperConfig
from hframe_post.printer.firmware_tables import END_MACRO, MACROS, KlipperTable
from hframe_post.printer.new_profile import (
    Finding,
    Known,
    Tables,
    as_float,
    profile_text,
    sweep,
)
from hframe_post.printer.settings import CHIP_NAME, SMOOTH_TIME_S, Printer

# By key of a profile: section and option of printer.cfg, and what holds without the option:
# Klipper's default, the value of another key, or None where Klipper needs it.
Options = dict[str, tuple[str, str, float | str | None]]
PATH: Options = {
    "velocity": ("printer", "max_velocity", None),
    "acceleration": ("printer", "max_accel", None),
    "square_corner_velocity": ("printer", "square_corner_velocity", 5.0),
}
LIMITS: Options = {
    "z_velocity": ("printer", "max_z_velocity", "velocity"),
    "z_acceleration": ("printer", "max_z_accel", "acceleration"),
    "extruder_velocity": ("extruder", "max_extrude_only_velocity", "flow"),
    "extruder_acceleration": ("extruder", "max_extrude_only_accel", "growth"),
    "extruder_corner_velocity": ("extruder", "instantaneous_corner_velocity", 1.0),
    "filament_diameter": ("extruder", "filament_diameter", 1.75),
}
RETRACTION: Options = {
    "length": ("firmware_retraction", "retract_length", 0.0),
    "speed": ("firmware_retraction", "retract_speed", 20.0),
    "return_speed": ("firmware_retraction", "unretract_speed", 10.0),
    "extra": ("firmware_retraction", "unretract_extra_length", 0.0),
}
EXTRUDER: Options = {
    "advance": ("extruder", "pressure_advance", 0.0),
    "smooth_time": ("extruder", "pressure_advance_smooth_time", SMOOTH_TIME_S),
}
SHAPERS: Options = {
    key: ("input_shaper", key, 0.0) for key in (f"shaper_freq_{axis}" for axis in "xyz")
}
DEFAULT = "Klipper's default"
SHAPES = re.compile(r"^\s*SET_INPUT_SHAPER\b[^\n]*SHAPER_FREQ", re.MULTILINE | re.IGNORECASE)


def kinematics_in(config: KlipperConfig) -> tuple[str, ...]:
    """Return the kinematics that the printer may have, the safest first. Raises HframeError."""
    kind = config.text("printer", "kinematics")
    if kind not in KINEMATICS:
        usable = ", ".join(KINEMATICS)
        raise HframeError(
            f"{config.path}: [printer] kinematics: {kind or 'missing'}; hframe-post can only "
            f"compensate {usable}"
        )
    return KINEMATICS[kind]


def from_klipper(config: KlipperConfig) -> Tables:
    """Return the settings that a printer.cfg decides. Raises HframeError if a number is missing."""
    path = _read(config, PATH)
    acceleration = path["acceleration"]
    retracts = config.number("firmware_retraction", "retract_length", 0.0) > 0.0
    # a file that was not found may set a shaper
    shapers = {k: v for k, v in SHAPERS.items() if not config.missing or config.text(*v[:2])}
    tables: Tables = {
        "travel": {axis: _range(config, axis) for axis in "xy"},
        "limits": path | _read(config, LIMITS, path | _extruder(config, path)),
        "retraction": _read(config, RETRACTION) if retracts else {},
        # also where slicers set the advance: the stream restores the averaging
        "extruder": _read(config, EXTRUDER) if config.has("extruder") else {},
        "speed": {"acceleration": acceleration},
        "sweep": {**sweep(acceleration), **_chips(config)},
        "firmware.klipper": {
            **path,
            "minimum_cruise_ratio": _option(
                config, "printer", "minimum_cruise_ratio", config.cruise_ratio()
            ),
            **_read(config, shapers),
            "end_macro": Known(END_MACRO, "of hframe.cfg: restores what printer.cfg sets"),
        },
    }
    if (steps := _steps(config)) is not None:
        tables["steps"] = steps
    for section in config.sections("dual_carriage")[:1]:
        tables["firmware"] = {"other_tools": Known(("T1",), f"[{section}] prints then")}
    if config.missing:  # a file that was not found may set it
        return {name: table for name, table in tables.items() if table}
    return tables


def _chips(config: KlipperConfig) -> dict[str, Known]:
    """Return the accelerometers of x and y, as Klipper's commands name them, if it is decided."""
    section, found = "resonance_tester", dict[str, Known]()
    for axis in "xy":
        keys = [key for key in (f"accel_chip_{axis}", "accel_chip") if config.text(section, key)]
        if keys:
            chip, origin = config.text(section, keys[0]), f"{keys[0]} of [{section}]"
        else:
            chip, origin = " ".join(config.accelerometers()), "the only accelerometer"
        words = chip.split()
        if words and CHIP_NAME.fullmatch(words[-1]) and (keys or len(words) == 1):
            found[f"chip_{axis}"] = Known(words[-1], origin)
    return found


def _read(
    config: KlipperConfig, options: Options, others: Mapping[str, Known] | None = None
) -> dict[str, Known]:
    """Return values by key of a profile. others: those that may hold without an option, by key."""
    found = dict[str, Known]()
    for key, (section, option, default) in options.items():
        usual = (others or {})[default] if isinstance(default, str) else default
        found[key] = _option(config, section, option, usual)
    return found


def _option(config: KlipperConfig, section: str, key: str, default: float | Known | None) -> Known:
    """Return the number in printer.cfg, or what Klipper uses without it. Raises HframeError."""
    value, place = config.number(section, key), config.place(section, key)
    if not math.isnan(value):
        if default is None and not 0.0 < value < 1e9:
            raise HframeError(f"{config.path}: [{section}] {key}: {value:g} is not possible")
        return Known(value, f"{key} of [{section}]", place)
    if default is None:
        raise HframeError(f"{config.path}: [{section}] {key} is missing{config.lost}")
    if isinstance(default, Known):
        default = replace(default, origin=f"{default.origin}, without {key}")
    else:
        default = Known(default, f"{DEFAULT} for {key}")
    return replace(default, place=place, assumed=bool(config.missing))


def _range(config: KlipperConfig, axis: str) -> Known:
    section = f"stepper_{axis}"
    low, high = config.number(section, "position_min", 0.0), config.number(section, "position_max")
    if not low < high:
        raise HframeError(
            f"{config.path}: [{section}] position_max is missing, or below position_min"
            f"{config.lost}"
        )
    origin = f"position_min and position_max of [{section}]"
    return Known((low, high), origin, config.place(section, "position_max"))


def _extruder(config: KlipperConfig, path: Mapping[str, Known]) -> dict[str, Known]:
    """Return the limits of filament as Klipper computes them from those of the path.

    Klipper lets the extruder follow a move whose line is max_extrude_cross_section (mm²) thick.
    """
    if not (diameter := config.number("extruder", "filament_diameter", 1.75)) > 0.0:
        raise HframeError(f"{config.path}: [extruder] filament_diameter must be above 0")
    thickest = 4.0 * config.number("extruder", "nozzle_diameter", 0.4) ** 2
    thickest = config.number("extruder", "max_extrude_cross_section", thickest)
    share = thickest / (math.pi / 4.0 * diameter**2)
    most = {"flow": ("velocity", 1e4), "growth": ("acceleration", 1e6)}  # what a profile takes
    found = dict[str, Known]()
    for name, (of, limit) in most.items():
        value = min(float(f"{share * as_float(path[of]):.6g}"), limit)
        found[name] = Known(value, "as Klipper computes it")
    return found


def _steps(config: KlipperConfig) -> dict[str, Known] | None:
    """Return mm per step of each motor, none if x and y differ; None if one is not known."""
    sections = {"belt": "stepper_x", "z": "stepper_z", "e": "extruder"}
    sizes = {name: config.step(section) for name, section in sections.items()}
    y = config.step("stepper_y")
    if not all(1e-6 <= size <= 10.0 for size in (*sizes.values(), y)):
        return None
    if not math.isclose(sizes["belt"], y, rel_tol=0.01):
        return {}
    return {
        name: Known(sizes[name], f"rotation_distance and microsteps of [{section}]",
                    config.place(section, "rotation_distance"))
        for name, section in sections.items()
    }  # fmt: skip


def text_from_klipper(config: KlipperConfig) -> str:
    """Return a new profile for a printer.cfg, with the safest kinematics. Raises HframeError."""
    kind = kinematics_in(config)[0]
    tables = {"kinematics": {"type": Known(kind, "kinematics of [printer]")}}
    return profile_text(tables | from_klipper(config), f"made from {config.path.name}")


# ----------------------------------------------------------------------
# printer.cfg, as `setup` reads it.


class KlipperSource(Source):
    """A printer.cfg. Raises HframeError if it is none, or if its printer cannot be compensated."""

    alone = "for Klipper give printer.cfg alone: it names all that it needs"

    def __init__(self, path: Path) -> None:
        self.path, self._config = path, KlipperConfig(path)
        self.possible, self.decided = kinematics_in(self._config), "kinematics of [printer]"
        self.warnings = [self._config.unsaved] if self._config.unsaved else []
        self.warnings += warnings(self._config)
        names = ", ".join(self._config.accelerometers())
        self.sensors = names or "none in printer.cfg; you need one to measure"

    def tables(self, kinematics: str, bed: tuple[float, float] | None) -> Tables:
        return from_klipper(self._config)

    @property
    def missing(self) -> str:
        return "the include that finds no file" if self._config.missing else ""

    def findings(self, profile: Printer, remedy: str, again: str) -> Iterator[Finding]:
        config = self._config
        for text in self.warnings:
            yield Finding(text == config.unsaved, text)
        yield from self.differing(profile, remedy)
        yield from check_stream(config, profile)
        yield from check_live(config, profile)
        yield from check_macros(config, profile, again)

    def companions(self, profile: Printer) -> dict[str, str]:
        return {FILE: macros(profile, self._config)}

    def next_steps(self, profile: Printer, target: Path, quoted: Callable[[Path], str]) -> str:
        sections = target.with_name(FILE)
        include = f"[include {sections.name}]"
        if self._config.has(include[1:-1]):
            first = f"Copy {sections} next to your printer.cfg, which includes it already."
        else:
            first = (
                f"Copy {sections} next to your printer.cfg, and add this line to printer.cfg, at "
                f"its end but above the SAVE_CONFIG block:\n     {include}"
            )
        if not profile.invented:
            return f"\nNext:\n  1. {first}\n  2. Restart Klipper."
        return f"""
Next:
  1. {first}
  2. Restart Klipper, and run hframe-post measure -o recordings/measure.gcode, which says how to go
     on. Or, with recordings of TEST_RESONANCES (OUTPUT=raw_data) in the folder recordings:
     hframe-post identify recordings --printer-cfg {quoted(self.path)} -o {quoted(target)}"""


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


def check_stream(config: KlipperConfig, printer: Printer) -> Iterator[Finding]:
    """Yield what converted files need and printer.cfg lacks, and what distorts them."""
    klipper = printer.firmware.table(KlipperTable)
    name = klipper.end_macro if klipper is not None else ""
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
