"""New profiles, from what the firmware says of itself: each number, and where it came from.

A line of such a profile is ``acceleration = 8000    # 8000 (max_accel of [printer])``. The comment
repeats the value: `edit.updated` sees from it what was changed since.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import dataclass

from hframe_post.errors import HframeError
from hframe_post.model.kinematics import Kinematics
from hframe_post.printer.firmware_tables import END_MACRO
from hframe_post.printer.klipper_cfg import KlipperConfig
from hframe_post.printer.settings import CHIP_NAME

KINEMATICS = {  # ours, the safest first, by Klipper's name
    "corexy": ("corexy", "hbot"),
    "hybrid_corexy": ("hybrid-corexy",),
    "corexz": ("corexz",),
    "cartesian": ("cartesian",),
}
# Compensation moves harder than the path: a cube at max_accel and a higher jerk, on simulated
# printers with modes from 18 to 55 Hz, needs up to 2.5 times max_accel. The acceleration that a
# slow printer's owner allows is no limit of its motors: at every corner they change their speed at
# once. A command that takes CORNER for it, with an effort of 1 to 10, leaves the least error.
MORE_ACCELERATION = 1.5  # times max_accel, as far as HARD
HARD = 8000.0  # mm/s²
CORNER = 0.002  # s
VELOCITY_HEADROOM = 1.1
SWEEP_AMPLITUDE = 5000.0  # mm/s², unless max_accel is less
DEFAULT = "Klipper's default"
AS_BEFORE = "as before"  # origin of what an earlier setup found

Value = float | tuple[float, float] | tuple[str] | str | bool


@dataclass(frozen=True, slots=True)
class Known:
    """A value of a profile and its origin, in words."""

    value: Value
    origin: str

    def as_toml(self) -> str:
        if isinstance(self.value, str | bool):
            return json.dumps(self.value, ensure_ascii=False)
        if isinstance(self.value, tuple):
            items = (json.dumps(v) if isinstance(v, str) else f"{v:.9g}" for v in self.value)
            return f"[{', '.join(items)}]"
        return f"{self.value:.9g}"

    def comment(self) -> str:
        return f"{self.as_toml()} ({self.origin})"


Tables = dict[str, dict[str, Known]]  # settings by table; a table without any does not exist

# What an inexact model leaves is excited by the path, mostly where it brakes before a corner
RAMP = 0.01  # s in which max_accel is reached: a third less error for 1 % (at most 8 %) more time
BRAKING = 5000.0  # mm/s²: on fast printers a third less error for 1 % more time
CLOCK = Known(1e5, "for files of steps: at most one step per tick")


def as_float(known: Known) -> float:
    assert isinstance(known.value, float)
    return known.value


# ---------------------------------------------------------------------- from printer.cfg


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


def from_klipper(config: KlipperConfig, kinematics: str) -> Tables:
    """Return the settings that a printer.cfg decides. Raises HframeError if a number is missing."""
    velocity = _needed(config, "printer", "max_velocity")
    acceleration = _needed(config, "printer", "max_accel")
    corner = corner_in(config)
    tables: Tables = {
        "travel": {axis: _range(config, axis) for axis in "xy"},
        "limits": {
            "velocity": velocity,
            "acceleration": acceleration,
            **gentle(acceleration),
            "square_corner_velocity": corner,
            "z_velocity": _or(config, "printer", "max_z_velocity", velocity),
            "z_acceleration": _or(config, "printer", "max_z_accel", acceleration),
            **extruder(config, velocity, acceleration),
        },
        "motors": motors(kinematics, velocity, acceleration, corner),
        "steps": _steps(config),
        "retraction": _retraction(config),
        "speed": {"acceleration": acceleration},
        "sweep": {**sweep(acceleration), **_chips(config)},
        "firmware.klipper": {
            "velocity": velocity,
            "acceleration": acceleration,
            "square_corner_velocity": corner,
            "minimum_cruise_ratio": _or(
                config, "printer", "minimum_cruise_ratio", config.cruise_ratio()
            ),
            **_shaper(config),
            "end_macro": Known(END_MACRO, "of hframe.cfg: restores what printer.cfg sets"),
        },
    }
    for section in config.sections("dual_carriage")[:1]:
        tables["firmware"] = {"other_tools": Known(("T1",), f"[{section}] prints then")}
    # a file that was not found may set it
    unknown = ("steps", "retraction") if config.missing else ("steps",)
    return {name: table for name, table in tables.items() if table or name not in unknown}


def gentle(acceleration: Known) -> dict[str, Known]:
    """Return deceleration and jerk of the path, low enough for a model that is a little off."""
    most = as_float(acceleration)
    origin = "low, for small errors; 'hframe-post tune' finds yours"
    values = {"deceleration": min(most, BRAKING), "jerk": float(f"{most / RAMP:.3g}")}
    return {name: Known(value, origin) for name, value in values.items()}


def corner_in(config: KlipperConfig) -> Known:
    """Return Klipper's speed through a right angle."""
    return _or(config, "printer", "square_corner_velocity", 5.0)


def motors(
    kinematics: str, velocity: Known, acceleration: Known, corner: Known
) -> dict[str, Known]:
    """Return the limits of the belts for a path with these limits in any direction.

    corner: speed through a right angle.
    """
    belts = 1.0 / Kinematics(kinematics).min_speed_ratio
    diagonal = "√2 × " if belts > 1.0 else ""
    path, turned = as_float(acceleration), as_float(corner)
    needed = round(path + MORE_ACCELERATION * min(path, HARD))
    reason = "which compensation may need"
    if (turning := round(path + turned / CORNER)) > needed:
        needed, reason = turning, f"{reason} at corners of {turned:g} mm/s"
    return {
        "belt_velocity": Known(
            round(VELOCITY_HEADROOM * belts * as_float(velocity), 1),
            f"{VELOCITY_HEADROOM:g} × {diagonal}the velocity above",
        ),
        "belt_acceleration": Known(
            float(round(belts * needed)), f"{diagonal}{needed}, {reason}; less if motors skip"
        ),
    }


def sweep(acceleration: Known) -> dict[str, Known]:
    if as_float(acceleration) < SWEEP_AMPLITUDE:
        return {"amplitude": acceleration}
    return {"amplitude": Known(SWEEP_AMPLITUDE, "usual; the acceleration above allows it")}


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


def _needed(config: KlipperConfig, section: str, key: str) -> Known:
    value = config.number(section, key)
    if math.isnan(value):
        where = f"{config.path}: [{section}] {key} is missing"
        lost = f"; {config.missing[0]}" if config.missing else ""
        raise HframeError(where + lost)
    if not 0.0 < value < 1e9:
        raise HframeError(f"{config.path}: [{section}] {key}: {value:g} is not possible")
    return Known(value, f"{key} of [{section}]")


def _or(config: KlipperConfig, section: str, key: str, default: float | Known) -> Known:
    """Return the number in printer.cfg, or what Klipper uses without it."""
    value = config.number(section, key)
    if not math.isnan(value):
        return Known(value, f"{key} of [{section}]")
    if isinstance(default, Known):
        return Known(default.value, f"{default.origin}, without {key}")
    return Known(default, f"{DEFAULT} for {key}")


def _range(config: KlipperConfig, axis: str) -> Known:
    section = f"stepper_{axis}"
    low, high = config.number(section, "position_min", 0.0), config.number(section, "position_max")
    if not low < high:
        raise HframeError(
            f"{config.path}: [{section}] position_max is missing, or below position_min"
        )
    return Known((low, high), f"position_min and position_max of [{section}]")


def extruder(config: KlipperConfig, velocity: Known, acceleration: Known) -> dict[str, Known]:
    """Return the limits of filament; those not given as Klipper computes them.

    Klipper lets the extruder follow a move whose line is max_extrude_cross_section (mm²) thick.
    """
    diameter = _or(config, "extruder", "filament_diameter", 1.75)
    if not as_float(diameter) > 0.0:
        raise HframeError(f"{config.path}: [extruder] filament_diameter must be above 0")
    thickest = 4.0 * config.number("extruder", "nozzle_diameter", 0.4) ** 2
    thickest = config.number("extruder", "max_extrude_cross_section", thickest)
    share = thickest / (math.pi / 4.0 * as_float(diameter) ** 2)

    def limit(key: str, of: Known, most: float) -> Known:
        computed = min(float(f"{share * as_float(of):.6g}"), most)  # what a profile takes
        return _or(config, "extruder", key, Known(computed, "as Klipper computes it"))

    return {
        "extruder_velocity": limit("max_extrude_only_velocity", velocity, 1e4),
        "extruder_acceleration": limit("max_extrude_only_accel", acceleration, 1e6),
        "extruder_corner_velocity": _or(config, "extruder", "instantaneous_corner_velocity", 1.0),
        "filament_diameter": diameter,
    }


def _steps(config: KlipperConfig) -> dict[str, Known]:
    """Return mm per step of each motor; nothing if one cannot be computed or x and y differ."""
    sections = {"belt": "stepper_x", "z": "stepper_z", "e": "extruder"}
    sizes = {name: config.step(section) for name, section in sections.items()}
    same = math.isclose(sizes["belt"], config.step("stepper_y"), rel_tol=0.01)  # for x and y
    if not same or not all(1e-6 <= size <= 10.0 for size in sizes.values()):
        return {}
    found = {
        name: Known(sizes[name], f"rotation_distance and microsteps of [{section}]")
        for name, section in sections.items()
    }
    return {**found, "clock_hz": CLOCK}


def _retraction(config: KlipperConfig) -> dict[str, Known]:
    section = "firmware_retraction"
    if not config.number(section, "retract_length", 0.0) > 0.0:
        return {}
    return {
        "length": _or(config, section, "retract_length", 0.0),
        "speed": _or(config, section, "retract_speed", 20.0),
        "return_speed": _or(config, section, "unretract_speed", 10.0),
        "extra": _or(config, section, "unretract_extra_length", 0.0),
    }


def _shaper(config: KlipperConfig) -> dict[str, Known]:
    return {
        key: _or(config, "input_shaper", key, 0.0)
        for key in (f"shaper_freq_{axis}" for axis in "xyz")
        # a file that was not found may set it
        if not config.missing or config.text("input_shaper", key)
    }


def text_from_klipper(config: KlipperConfig) -> str:
    """Return a new profile for a printer.cfg, with the safest kinematics. Raises HframeError."""
    kind = kinematics_in(config)[0]
    tables = {"kinematics": {"type": Known(kind, "kinematics of [printer]")}}
    return profile_text(tables | from_klipper(config, kind), f"made from {config.path.name}")


# ---------------------------------------------------------------------- as text

TITLES = {
    "kinematics": "how the belts move the nozzle",
    "travel": "where the nozzle may go",
    "limits": "of the planned path; limits set in a file lower these",
    "motors": "limits of every command, measured at the belts",
    "steps": "mm per step",
    "retraction": "what G10 and G11 do",
    "sweep": "the motion that measures the printer",
    "speed": "of --max-error: largest acceleration of the path",
    "firmware.klipper": "limits before and after a print",
    "firmware.marlin": "settings before and after a print: those of M503",
}
COLUMN = 32


def profile_text(tables: Tables, description: str) -> str:
    """Return a new profile as TOML. It has no plant yet: the nozzle follows the motors exactly."""
    dialect = "marlin" if "firmware.marlin" in tables else "klipper"
    others = dict(tables)
    firmware = "".join(f"{_line(*item)}\n" for item in others.pop("firmware", {}).items())
    settings = "\n".join(line for name, table in others.items() for line in _table(name, table))
    x = tables["travel"]["x"].value
    assert isinstance(x, tuple)
    return f"""\
# A profile for hframe-post. Lengths in mm, times in s. A comment that begins with a value shows
# what was found, and where. Change what you like: 'hframe-post setup' keeps your changes.

description = {json.dumps(description, ensure_ascii=False)}

{settings}
[firmware]
dialect = "{dialect}"
{firmware}
[compensation]          # 'hframe-post identify' chooses these for your printer
strategy = "racking"    # ringing and, on an H-bot, racking
L = 5                   # samples between knots
n_C = 88                # control points in a window
n_up = 44               # control points kept from each window
effort = [10, 10]       # weight on the second difference of the command in x and y

[plant]                 # Not measured yet: 'hframe-post identify' writes it (docs/identify.md).
invented = true         # Until then nothing is compensated.
Ts = 0.001
x_c = {sum(map(float, x)) / 2.0:.9g}
Gxx = {{gain = 1.0, zeros = [], poles = []}}
Gyy = {{gain = 1.0, zeros = [], poles = []}}
"""


def _table(name: str, table: dict[str, Known]) -> Iterator[str]:
    if not table:
        return
    yield f"{f'[{name}]':24s}# {TITLES[name]}"
    for key, known in table.items():
        yield _line(key, known)
    yield ""


def _line(key: str, known: Known) -> str:
    return f"{f'{key} = {known.as_toml()}':{COLUMN}s}# {known.comment()}"
