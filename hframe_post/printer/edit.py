"""Profiles as TOML text: changes that keep the rest of it, comments included, and new ones."""

from __future__ import annotations

import json
import math
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import tomlkit
from tomlkit.exceptions import TOMLKitError

from hframe_post.arrays import TS, Complex
from hframe_post.errors import HframeError, PrinterError
from hframe_post.model.lpfbs import Window
from hframe_post.model.plant import Plant
from hframe_post.model.transfer_function import TransferFunction
from hframe_post.printer.klipper_cfg import KlipperConfig
from hframe_post.printer.profile import model_digest, parse, shipped, text_of

Windows = tuple[Window, Window]
Tables = Mapping[str, dict[str, Any]]  # settings, by the names of their tables


def with_windows(
    name_or_path: str, windows: Windows, limits: Mapping[str, float] | None = None
) -> str:
    """Return a profile's text with these windows. A shipped profile is extended, not copied.

    limits: changes to [limits]. Raises PrinterError if the text cannot be changed safely.
    """
    tables = {"compensation": _settings(windows), **({"limits": dict(limits)} if limits else {})}
    return _changed(name_or_path, tables)


def with_plant(
    name_or_path: str, plant: Plant, windows: Windows, notes: Sequence[str],
    uncertainty: float | None = None,
) -> str:  # fmt: skip
    """Return a profile's text with this plant, these windows, and notes as comments.

    A shipped profile is extended, not copied. The plant counts as measured: ``invented`` is
    removed, and a profile that compensated nothing compensates racking. uncertainty: share by
    which the printer may differ from the plant, if known. Raises PrinterError if the text cannot
    be changed safely.
    """
    before = parse(_text_and_newline(name_or_path)[0], name_or_path)
    strategy = {"strategy": "racking"} if before.compensation.strategy == "none" else {}
    tables = {"compensation": {**_settings(windows), **strategy}}
    table = _plant(plant, notes, before.invented, uncertainty)
    return _changed(name_or_path, tables, table, ("plant", "verified"))


def with_verification(name_or_path: str, date: str, reduction: float) -> str:
    """Return a profile's text with the mark of `verify`.

    Raises PrinterError if the text cannot be changed safely.
    """
    text, _ = _text_and_newline(name_or_path)
    firmware = parse(text, name_or_path).firmware.dialect
    mark = {"date": date, "reduction": round(reduction, 4), "firmware": firmware,
            "model": model_digest(text)}  # fmt: skip
    changed = _changed(name_or_path, {}, tomlkit.dumps({"verified": mark}), ("verified",))
    if parse(changed, name_or_path).verified is None:
        raise PrinterError("the mark does not fit this model", "verified", name_or_path)
    return changed


def _changed(
    name_or_path: str, tables: Tables, appended: str = "", dropped: Sequence[str] = ()
) -> str:
    """Return the profile's text with these settings, and with TOML that replaces some tables."""
    text, newline = _text_and_newline(name_or_path)
    try:
        before = tomllib.loads(text)
        kept = {name: table for name, table in before.items() if name not in dropped}
        settings = {name: {**before.get(name, {}), **new} for name, new in tables.items()}
        changed = _edited(text, tables, appended, dropped)
        if tomllib.loads(changed) != {**kept, **settings, **tomllib.loads(appended)}:
            raise ValueError("more was changed than intended")
    except (TOMLKitError, ValueError, RecursionError):
        advice = (
            "this file cannot be changed safely: start a new one that extends a shipped profile"
        )
        if not appended:
            lines = (f"{key} = {value}" for new in tables.values() for key, value in new.items())
            advice = f"write these lines yourself: {', '.join(lines)}"
        raise PrinterError(advice, next(iter(tables), "verified"), name_or_path) from None
    parse(changed, name_or_path)  # raises if it cannot be loaded
    return changed.replace("\n", newline)


def _text_and_newline(name_or_path: str) -> tuple[str, str]:
    """Return the text to change and its line end. A shipped profile is extended."""
    if name_or_path in shipped():
        return f'extends = "{name_or_path}"\n', "\n"
    text = text_of(name_or_path)
    if 0 < text.count("\n") == text.count("\r\n"):
        return text.replace("\r\n", "\n"), "\r\n"
    return text, "\n"


def _settings(windows: Windows) -> dict[str, Any]:
    x, y = windows
    effort = [float(x.effort), float(y.effort)]
    return {"L": x.L, "n_C": x.n_C, "n_up": x.n_up, "effort": effort}


def _edited(text: str, tables: Tables, appended: str, dropped: Sequence[str]) -> str:
    document = tomlkit.parse(text)
    for name, settings in tables.items():
        if name not in document:
            document.append(name, tomlkit.table())
        table: Any = document[name]
        for key, value in settings.items():
            if isinstance(value, list) and len(table.get(key, ())) == len(value):
                for k, number in enumerate(value):  # one by one, so that comments between them stay
                    table[key][k] = number
            else:
                table[key] = value
    if not appended:
        return document.as_string()
    for name in dropped:
        document.pop(name, None)
    return f"{document.as_string().rstrip()}\n\n{appended}"


def _plant(
    plant: Plant, notes: Sequence[str], was_invented: bool, uncertainty: float | None
) -> str:
    """Return the table ``plant`` with notes, and its transfer functions.

    Without racking it has a gain of zero, since the profile that is extended may rack.
    """
    no_racking = TransferFunction(np.zeros(0, complex), np.zeros(0, complex), 0.0)
    functions = {"Gxx": plant.Gxx, "Gyy": plant.Gyy, "Gxtheta": plant.Gxtheta or no_racking}
    comments = "".join(f"# {note}".rstrip() + "\n" for note in notes)
    measured = "invented = false\n" if was_invented else ""
    known = "" if uncertainty is None else f"uncertainty = {uncertainty!r}\n"
    head = f"[plant]\n{comments}{measured}{known}Ts = {TS}\nx_c = {plant.x_c!r}\n"
    return head + "".join(_transfer_function(name, G) for name, G in functions.items())


def _transfer_function(name: str, G: TransferFunction) -> str:
    roots = {"zeros": G.zeros, "poles": G.poles}
    lists = "".join(f"{key} = [{_pairs(values)}]\n" for key, values in roots.items())
    return f"\n[plant.{name}]\ngain = {G.gain!r}\n{lists}"


def _pairs(roots: Complex) -> str:
    pairs = (f"    [{root.real!r}, {root.imag!r}],\n" for root in (roots + 0.0).tolist())
    return "\n" + "".join(pairs) if len(roots) else ""


# ---------------------------------------------------------------------- new profiles

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

{_klipper(known)}
[plant]                 # Not measured yet, so nothing is compensated until `hframe-post
invented = true         # identify` has written your printer's plant here (docs/identify.md)
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
