"""What Marlin's answers say: the settings of a profile, and what the owner must know.

By key of a profile: the command of M503 and the letters that give it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from hframe_post.errors import HframeError
from hframe_post.firmware.base import Source
from hframe_post.firmware.marlin.m503 import ASSUMED, TWO_CARRIAGES, MarlinSettings
from hframe_post.native.planning import square_corner_velocity
from hframe_post.printer.new_profile import Known, Tables, as_float, sweep
from hframe_post.printer.settings import Printer

LIMITS = {
    "z_velocity": ("M203", "Z"), "z_acceleration": ("M201", "Z"),
    "extruder_velocity": ("M203", "E"), "extruder_acceleration": ("M204", "R"),
}  # fmt: skip
MOTORS = {"belt": "X", "z": "Z", "e": "E"}  # by the letter of M92
TABLE = {
    "max_velocity": ("M203", "XY"), "max_acceleration": ("M201", "XY"),
    "max_acceleration_e": ("M201", "E"), "acceleration": ("M204", "P"),
    "travel_acceleration": ("M204", "T"), "retract_acceleration": ("M204", "R"),
}  # fmt: skip
IF_SET = {  # in builds that have them; 0: off
    "min_velocity": ("M205", "S"), "min_travel_velocity": ("M205", "T"),
    "linear_advance": ("M900", "K"), "shaper_freq_x": ("M593 X", "F"),
    "shaper_freq_y": ("M593 Y", "F"), "fixed_time_motion": ("M493", "S"),
    "fixed_time_trajectory": ("M494", "T"), "fixed_time_smoothing": ("M494", "XY"),
    "fixed_time_smoothing_z_e": ("M494", "ZE"),
}  # fmt: skip
DEFAULT_SEGMENT_US = 20000.0  # µs, Marlin's DEFAULT_MINSEGMENTTIME


def from_marlin(settings: MarlinSettings, travel: dict[str, Known]) -> Tables:
    """Return the settings of a new profile. Raises HframeError if a number is missing."""
    word = settings.word
    velocity, highest = (_least(settings, command) for command in ("M203", "M201"))
    acceleration = min(word("M204", "P"), highest, key=as_float)
    deviation, a = word("M205", "J", 0.0), as_float(acceleration)
    if J := as_float(deviation):
        speed = float(f"{square_corner_velocity(J, a):.3g}")
        corner = Known(speed, f"of M205 J{J:g} at {a:g} mm/s²")
        corners = jerks = {"junction_deviation": deviation}
    else:
        corner, corners = _least(settings, "M205"), {}
        jerks = {"jerk": settings.words("M205", "XY"), "jerk_e": word("M205", "E")}
    limits = {"velocity": velocity, "acceleration": acceleration, "square_corner_velocity": corner}
    tables: Tables = {
        "travel": travel,
        "limits": limits | corners | {key: word(*each) for key, each in LIMITS.items()},
        "steps": _steps(settings),
        "retraction": _retraction(settings),
        "extruder": {"advance": K} if (K := word("M900", "K", 0.0)).value else {},
        "speed": {"acceleration": acceleration},
        "sweep": sweep(acceleration),
        "firmware.marlin": {
            **{key: settings.words(*each) for key, each in TABLE.items()},
            **jerks,
            **_if_set(settings),
            **_build(settings),
        },
    }
    if settings.defined(TWO_CARRIAGES):
        tables["firmware"] = {"other_tools": Known(("T1",), f"{TWO_CARRIAGES} prints then")}
    return {name: table for name, table in tables.items() if table}


def _least(settings: MarlinSettings, command: str) -> Known:
    return min((settings.word(command, letter) for letter in "XY"), key=as_float)


def _steps(settings: MarlinSettings) -> dict[str, Known]:
    x, y = (as_float(settings.word("M92", letter)) for letter in "XY")
    if x != y:
        raise HframeError(
            f"{settings.name}: M92 X{x:g} and Y{y:g} differ, but x and y need equal steps. Where "
            f"they correct a part's size, send M92 Y{x:g} and M500, correct it in the slicer, and "
            "save M503 again; where pulleys or microsteps differ, give both axes the same"
        )
    found = dict[str, Known]()
    for name, letter in MOTORS.items():
        if not (steps := as_float(settings.word("M92", letter))) > 0.0:
            raise HframeError(f"{settings.name}: M92 {letter} must be above 0")
        found[name] = Known(1.0 / steps, f"1 / M92 {letter}")
    return found


def _retraction(settings: MarlinSettings) -> dict[str, Known]:
    if not as_float(length := settings.word("M207", "S", 0.0)) > 0.0:
        return {}
    speeds = {"speed": settings.word("M207", "F"), "return_speed": settings.word("M208", "F", 0.0)}
    return {
        "length": length,
        **{key: Known(as_float(a_minute) / 60.0, f"{a_minute.origin} / 60")
           for key, a_minute in speeds.items()},
        "extra": settings.word("M208", "S", 0.0),
    }  # fmt: skip


def _if_set(settings: MarlinSettings) -> dict[str, Known]:
    """Return what a printer need not have, and is not off."""
    segment = settings.word("M205", "B", DEFAULT_SEGMENT_US)
    table = {"min_segment_time": Known(as_float(segment) * 1e-6, "M205 B / 1000000")}
    optional = {key: settings.words(*each, 0.0) for key, each in IF_SET.items()}
    table |= {key: known for key, known in optional.items() if np.any(known.value)}
    if as_float(settings.word("M420", "S", 0.0)):
        table["bed_levelling"] = Known(True, "M420 S1, which our own files send after G28")
    if edges := settings.soft_endstops():
        table["soft_endstops"] = Known(edges, "the answer to M211")
    return table


def _build(settings: MarlinSettings) -> dict[str, Known]:
    """Return what depends on how the firmware was built."""
    table = {"planner": settings.planner or Known(ASSUMED, "assumed: M115 shows the version")}
    steps = settings.number("MIN_STEPS_PER_SEGMENT")
    if not math.isnan(steps):
        table["min_steps_per_segment"] = Known(steps, "MIN_STEPS_PER_SEGMENT of the build")
    if settings.defined("S_CURVE_ACCELERATION"):
        table["s_curve_acceleration"] = Known(True, "S_CURVE_ACCELERATION of the build")
    return table


class MarlinSource(Source):
    """What a printer with Marlin answered. Raises HframeError."""

    def __init__(self, files: Sequence[Path]) -> None:
        self.path = files[0]
        self._settings = MarlinSettings(files)
        self.possible, self.decided = self._settings.kinematics()
        self.warnings = self._settings.warnings()
        self.sensors = "one that a computer or a telephone records: Marlin reads none"
        self._travel = self._settings.travel()
        if not self._travel:
            self.no_travel = (
                f"{self.path} does not say how large the bed is: add --bed 220,220 with its width "
                "and depth in mm, or Configuration.h behind the file"
            )

    def tables(self, kinematics: str, bed: tuple[float, float] | None) -> Tables:
        travel = self._travel
        if bed is not None:
            x, y = bed
            travel = {"x": Known((0.0, x), "as you said"), "y": Known((0.0, y), "as you said")}
        return from_marlin(self._settings, travel)

    def next_steps(self, profile: Printer, target: Path, quoted: Callable[[Path], str]) -> str:
        if not profile.invented:
            return ""
        return f"""
Next, with an accelerometer: hframe-post measure -o sweep.gcode, which says how to go on, and
hframe-post identify recordings -o {quoted(target)}
With a ruler only: hframe-post calibrate-print --heat 210,60 -o tower.gcode
A compensated print that you stop midway leaves its limits in the board: send M501 and M82 then. Let
OctoPrint do that: put both into GCODE Scripts, After print job is cancelled."""
