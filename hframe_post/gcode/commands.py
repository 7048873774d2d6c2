"""What the commands of a sliced file mean to a post-processor, by firmware.

A command that is in no table may move the machine or leave it in another mode, so it runs
with the user's own limits and modes in force, and the position after it is unknown.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from hframe_post.errors import HframeError
from hframe_post.stream.types import Handling

STAMP = b"; processed by hframe-post"

Words = dict[str, float]  # letter → number of a command's words

MOTION_WORDS = {"G0": "XYZEF", "G1": "XYZEF", "G2": "XYZEFIJRP", "G3": "XYZEFIJRP", "G92": "XYZE"}
MODAL = frozenset({"G90", "G91", "M82", "M83", "G20", "G21", "G17", "G18", "G19"})
LIMIT_WORDS = {
    "M201": "XYZEFST",
    "M203": "XYZEFST",
    "M204": "PRST",
    "M205": "XYZEJSTB",
    "M220": "SBR",
}
MISREAD = {
    "G5": "splines cannot be followed",
    "G5.1": "splines cannot be followed",
    "G53": "machine coordinates cannot be followed",
    **{f"G{code}": "work coordinate systems cannot be followed" for code in range(54, 60)},
    "G92.1": "coordinate resets cannot be followed",
    "G93": "inverse-time feed cannot be followed",
    "G95": "feed per revolution cannot be followed",
}

_CARRIED = frozenset(
    {"M73", "M104", "M105", "M106", "M107", "M110", "M115", "M117", "M118", "M140", "M141"}
    | {"M155", "M207", "M208", "M209", "M221", "M300", "M413", "M486", "M566", "M572", "M900"}
)
_AT_REST = frozenset({"G4", "M109", "M190", "M191", "M400"})
_CARRIED_MACROS = frozenset(
    {b"EXCLUDE_OBJECT_DEFINE"}  # its START and END yield: what was skipped is caught up on after
    | {b"SET_PRINT_STATS_INFO", b"SET_PRESSURE_ADVANCE", b"SET_FAN_SPEED", b"SET_PIN", b"SET_LED"}
    | {b"SET_HEATER_TEMPERATURE", b"SET_DISPLAY_TEXT", b"SET_GCODE_VARIABLE", b"RESPOND"}
)
_MACROS_AT_REST = frozenset({b"TEMPERATURE_WAIT"})


@dataclass(frozen=True, slots=True)
class Dialect:
    """Where firmwares differ in what a command means.

    g90_sets_e: whether G90 makes E absolute and G91 makes it relative, as M82 and M83 do;
    elsewhere E is relative while the file is in G91, and M82 and M83 stay as they were.
    path_acceleration: what M204 asks for (mm/s²), given its words and what held before.
    dwell: seconds that G4 waits, given its words.
    """

    name: str
    g90_sets_e: bool
    path_acceleration: Callable[[Words, float], float]
    dwell: Callable[[Words], float]


def _klipper_acceleration(words: Words, before: float) -> float:
    """S, or the lower of P and T where both are given."""
    if "S" in words:
        return words["S"]
    return min(words["P"], words["T"]) if {"P", "T"} <= words.keys() else before


def _marlin_acceleration(words: Words, before: float) -> float:
    """S, else the lower of P (printing) and T (travel)."""
    if "S" in words:
        return words["S"]
    return min((words[letter] for letter in "PT" if letter in words), default=before)


def _klipper_dwell(words: Words) -> float:
    """P is in ms; S means nothing."""
    return words.get("P", 0.0) / 1000.0


def _marlin_dwell(words: Words) -> float:
    """P is in ms, S in s."""
    return words["P"] / 1000.0 if "P" in words else words.get("S", 0.0)


KLIPPER = Dialect("klipper", False, _klipper_acceleration, _klipper_dwell)
MARLIN = Dialect("marlin", True, _marlin_acceleration, _marlin_dwell)
DIALECTS = {each.name: each for each in (KLIPPER, MARLIN)}


def dialect(name: str) -> Dialect:
    """The dialect of the firmware ``name``. Raises HframeError if there is none."""
    if name not in DIALECTS:
        raise HframeError(f"no G-code dialect {name!r}; known are {', '.join(DIALECTS)}")
    return DIALECTS[name]


def command_handling(name: str, arguments: bytes) -> Handling:
    """How G, M and T commands other than moves, modes and limits reach the machine."""
    if name in _CARRIED:
        return Handling.CARRY
    retraction = name in ("G10", "G11") and not arguments.strip()  # with words: a tool's offset
    return Handling.REST if retraction or name in _AT_REST else Handling.RELEASE


def macro_handling(name: bytes) -> Handling:
    """How a Klipper macro or extended command (upper case) reaches the machine."""
    if name in _CARRIED_MACROS:
        return Handling.CARRY
    return Handling.REST if name in _MACROS_AT_REST else Handling.RELEASE


def may_be_zero(name: str, word: str) -> bool:
    """Whether zero is a meaning and not a mistake: corner speeds and ratios, no limits."""
    return name == "M205" or word in ("SQUARE_CORNER_VELOCITY", "MINIMUM_CRUISE_RATIO")
