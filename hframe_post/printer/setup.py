"""New profiles, from what a firmware says of itself: each number, and where it came from.

A line of such a profile is ``acceleration = 8000    # 8000 (max_accel of [printer])``. The comment
repeats the value: `update.updated` sees from it what was changed since.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import dataclass

from hframe_post.model.kinematics import Kinematics
from hframe_post.printer.firmware_tables import TABLES

# Compensation moves harder than the path: a cube at max_accel and a higher jerk, on simulated
# printers with modes from 18 to 55 Hz, needs up to 2.5 times max_accel. The acceleration that a
# slow printer's owner allows is no limit of its motors: at every corner they change their speed at
# once. A command that takes CORNER for it, with an effort of 1 to 10, leaves the least error.
MORE_ACCELERATION = 1.5  # times max_accel, as far as HARD
HARD = 8000.0  # mm/s²
CORNER = 0.002  # s
VELOCITY_HEADROOM = 1.1
SWEEP_AMPLITUDE = 5000.0  # mm/s², unless max_accel is less
AS_BEFORE = "as before"  # origin of what an earlier setup found

Value = float | tuple[float, ...] | tuple[str] | str | bool


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
# mm/s²; below it long ramps cost time only, 1 % at 500 mm/s², so they get shorter in proportion
SLOW = 2000.0
BRAKING = 5000.0  # mm/s²: on fast printers a third less error for 1 % more time
CLOCK = Known(1e5, "for files of steps: at most one step per tick")


def as_float(known: Known) -> float:
    assert isinstance(known.value, float)
    return known.value


def gentle(acceleration: Known) -> dict[str, Known]:
    """Return deceleration and jerk of the path, low enough for a model that is a little off."""
    most = as_float(acceleration)
    origin = "low, for small errors; 'hframe-post tune' finds yours"
    jerk = float(f"{most / (RAMP * min(1.0, most / SLOW)):.3g}")
    values = {"deceleration": min(float(math.ceil(most)), BRAKING), "jerk": jerk}
    return {name: Known(value, origin) for name, value in values.items()}


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


TITLES = {
    "kinematics": "how the belts move the nozzle",
    "travel": "where the nozzle may go",
    "limits": "of the planned path; limits set in a file lower these",
    "motors": "limits of every command, measured at the belts",
    "steps": "mm per step",
    "retraction": "what G10 and G11 do",
    "extruder": "how late the flow follows it: pressure advance",
    "sweep": "the motion that measures the printer",
    "speed": "of --max-error: largest acceleration of the path",
}
# About what prints have without compensation; walls show it, infill does not.
MAX_ERROR = """\
# max_error = {outer-wall = 0.05, inner-wall = 0.1, infill = 0.2}
#   mm: print as fast as that allows; 'hframe-post speed part.gcode' shows the time of each error.
#   The hot end counts as melting 15 mm³/s unless limits.flow says more or less. The limits of the
#   filament are read from files of OrcaSlicer, Bambu Studio, PrusaSlicer and Cura."""
FIRMWARE = "firmware."  # how the name of a firmware's table begins
COLUMN = 32


def profile_text(tables: Tables, description: str) -> str:
    """Return a new profile as TOML. It has no plant yet: the nozzle follows the motors exactly."""
    (dialect,) = (name[len(FIRMWARE) :] for name in tables if name.startswith(FIRMWARE))
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
    own = name.startswith(FIRMWARE)
    title = TABLES[name[len(FIRMWARE) :]].title if own else TITLES[name]
    yield f"{f'[{name}]':24s}# {title}"
    for key, known in table.items():
        yield _line(key, known)
    if name == "speed":
        yield MAX_ERROR
    yield ""


def _line(key: str, known: Known) -> str:
    return f"{f'{key} = {known.as_toml()}':{COLUMN}s}# {known.comment()}"
