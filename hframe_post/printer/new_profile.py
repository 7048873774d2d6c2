"""A new profile, with comments, from a printer.cfg or from answers."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, field

from hframe_post.errors import HframeError
from hframe_post.printer.klipper_cfg import KlipperConfig

BASES = {
    "hbot": "paper",
    "corexy": "example-corexy",
    "hybrid-corexy": "example-corexy",
    "corexz": "example-cartesian",
    "cartesian": "example-cartesian",
}
KINEMATICS = {  # ours, by Klipper's name; Klipper calls hbot corexy, too
    "corexy": "hbot",
    "hybrid_corexy": "hybrid-corexy",
    "corexz": "corexz",
    "cartesian": "cartesian",
}
START_JERK = 3e6  # mm/s³; costs 1 % of print time and reduces the error by an eighth
Range = tuple[float, float]


@dataclass
class Known:
    """A printer's properties; mm, s. The base profile has the rest, and those that are nan."""

    description: str
    kinematics: str
    x: Range
    y: Range
    velocity: float
    acceleration: float
    corner: float = 5.0
    z_velocity: float = math.nan
    z_acceleration: float = math.nan
    extruder_velocity: float = math.nan
    extruder_acceleration: float = math.nan
    extruder_corner_velocity: float = 1.0
    minimum_cruise_ratio: float = 0.5
    shaper_freq: Range = (0.0, 0.0)
    steps: dict[str, float] = field(default_factory=dict)


def from_klipper(config: KlipperConfig, description: str, kinematics: str | None) -> Known:
    """Return the properties in a printer.cfg.

    kinematics: needed to tell corexy from hbot; hbot if None. Raises HframeError if a number is
    missing.
    """
    kind = config.text("printer", "kinematics")
    if kind not in KINEMATICS:
        usable = ", ".join(KINEMATICS)
        raise HframeError(f"[printer] kinematics: {kind!r} is not supported, only {usable}")
    ranges = []
    for axis in "xy":
        low = config.number(f"stepper_{axis}", "position_min", 0.0)
        high = config.number(f"stepper_{axis}", "position_max")
        if not low < high:
            raise HframeError(f"[stepper_{axis}] position_max is missing, or below position_min")
        ranges.append((low, high))
    velocity, acceleration = (
        config.number("printer", f"max_{name}") for name in ("velocity", "accel")
    )
    if not (velocity > 0.0 and acceleration > 0.0):
        raise HframeError("[printer] max_velocity or max_accel is missing")
    steps = {"belt": "stepper_x", "z": "stepper_z", "e": "extruder"}
    shaper = tuple(config.number("input_shaper", f"shaper_freq_{a}", 0.0) for a in "xy")
    return Known(
        description, kinematics or KINEMATICS[kind],
        ranges[0], ranges[1], velocity, acceleration,
        config.number("printer", "square_corner_velocity", 5.0),
        config.number("printer", "max_z_velocity", velocity),
        config.number("printer", "max_z_accel", acceleration),
        config.number("extruder", "max_extrude_only_velocity"),
        config.number("extruder", "max_extrude_only_accel"),
        config.number("extruder", "instantaneous_corner_velocity", 1.0),
        config.number("printer", "minimum_cruise_ratio", 0.5),
        (shaper[0], shaper[1]),
        {name: config.step(motor) for name, motor in steps.items()},
    )  # fmt: skip


def text(known: Known) -> str:
    """Return the profile as TOML with comments. Its plant is marked as not measured."""
    base = BASES[known.kinematics]
    return f"""\
# A profile for hframe-post. Lengths in mm, times in s. All other settings are those of the
# profile that this one extends: 'hframe-post printers show {base}'.

extends = "{base}"
description = {json.dumps(known.description, ensure_ascii=False)}

{_machine(known)}
{_klipper(known)}
[plant]                 # Not measured yet, so nothing is compensated until `hframe-post
invented = true         # identify` has written your printer's plant here (docs/identify.md)
"""


def _machine(known: Known) -> str:
    return f"""\
[kinematics]
type = "{known.kinematics}"

[travel]                # where the nozzle may go, within position_min and position_max
x = [{known.x[0]!r}, {known.x[1]!r}]
y = [{known.y[0]!r}, {known.y[1]!r}]

[limits]                # limits of the planned path; limits set in a file lower these
velocity = {known.velocity:g}
acceleration = {known.acceleration:g}
jerk = {START_JERK!r}        # low, for a model with small errors; see `hframe-post tune`
square_corner_velocity = {known.corner:g}
{_given("z_velocity", known.z_velocity, "max_z_velocity of printer.cfg")}\
{_given("z_acceleration", known.z_acceleration, "max_z_accel")}\
{_given("extruder_velocity", known.extruder_velocity, "max_extrude_only_velocity")}\
{_given("extruder_acceleration", known.extruder_acceleration, "max_extrude_only_accel")}\
extruder_corner_velocity = {known.extruder_corner_velocity:g}  # instantaneous_corner_velocity

# [motors]              # limits of every command; without this table, the base profile's
# belt_velocity = …
# belt_acceleration = …
"""


def _klipper(known: Known) -> str:
    steps_lines = [f"{name} = {step:.9g}\n" for name, step in known.steps.items() if step > 0.0]
    comment = "[steps]                 # mm per step, from rotation_distance and microsteps\n"
    steps = "".join([comment, *steps_lines, "\n"]) if steps_lines else ""
    shapers = "".join(
        f"shaper_freq_{axis} = {hz:g}\n"
        for axis, hz in zip("xy", known.shaper_freq, strict=True)
        if hz > 0.0
    )
    return f"""\
{steps}[firmware]
dialect = "klipper"

[firmware.klipper]      # limits before and after a print: those of printer.cfg
velocity = {known.velocity:g}
acceleration = {known.acceleration:g}
square_corner_velocity = {known.corner:g}
minimum_cruise_ratio = {known.minimum_cruise_ratio:g}
{shapers}"""


def _given(name: str, value: float, comment: str) -> str:
    return "" if math.isnan(value) else f"{name} = {value:g}  # {comment}\n"
