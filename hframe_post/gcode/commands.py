"""What the commands of a sliced file mean to a post-processor, by firmware.

A command that is in no table may move the machine or leave it in another mode, so it runs
with the user's own limits and modes in force, and the position after it is unknown.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from enum import Enum

from hframe_post.errors import HframeError
from hframe_post.stream.types import Handling

STAMP = b"; processed by hframe-post"

Words = dict[str, float]  # letter → number of a command's words
Accelerations = tuple[float, float]  # of moves that extrude and of those that do not, mm/s²

MOTION_WORDS = {
    "G0": "XYZEF",
    "G1": "XYZEF",
    "G2": "XYZEFIJRP",
    "G3": "XYZEFIJRP",
    "G5": "XYZEFIJPQ",
    "G92": "XYZE",
}
MODAL = frozenset({"G90", "G91", "M82", "M83", "G20", "G21", "G17", "G18", "G19"})
LIMITS = "SET_VELOCITY_LIMIT"
LIMIT_WORDS = {"M201": "XYZE", "M203": "XYZE", "M204": "PTS", "M205": "XY", "M220": "S"}
LIMIT_PARAMETERS = ("VELOCITY", "ACCEL", "SQUARE_CORNER_VELOCITY", "MINIMUM_CRUISE_RATIO")
MISREAD = {
    "G5.1": "splines of the second degree cannot be followed",
    "G53": "machine coordinates cannot be followed",
    **{f"G{code}": "work coordinate systems cannot be followed" for code in range(54, 60)},
    "G92.1": "coordinate resets cannot be followed",
    "G93": "inverse-time feed cannot be followed",
    "G95": "feed per revolution cannot be followed",
}


class Effect(Enum):
    """What a command that is no move, mode or limit does to the motion."""

    NONE = "moves nothing"
    WAITS = "moves nothing, but must happen at rest"
    RETURNS = "may move or change modes, and comes back to where it was"
    UNKNOWN = "may move or change modes"

    @property
    def handling(self) -> Handling:
        """How such a command must reach the machine."""
        if self is Effect.NONE:
            return Handling.CARRY
        return Handling.REST if self is Effect.WAITS else Handling.RELEASE


_NONE = (
    # temperatures, fans, lights, sounds, power
    "M104 M106 M107 M108 M140 M141 M142 M150 M300 M301 M302 M304 M355 M710",
    # what a screen, a host or a log is told
    "M27 M31 M70 M72 M73 M74 M75 M77 M105 M110 M111 M114 M115 M117 M118 M119 M136 M137 M155",
    "M412 M413 M555 M862 M862.1 M862.2 M862.3 M862.4 M862.5 M862.6",
    # settings of the extruder
    "M101 M102 M103 M126 M127 M207 M208 M209 M211 M221 M566 M572 M900",
    # limits of other firmwares, which these know nothing of
    "M202 M320 M592",
    "EXCLUDE_OBJECT_DEFINE SET_PRINT_STATS_INFO SET_PRESSURE_ADVANCE SET_FAN_SPEED SET_PIN",
    "SET_HEATER_TEMPERATURE SET_DISPLAY_TEXT SET_GCODE_VARIABLE RESPOND SET_RETRACTION",
    "SET_LED SET_LED_EFFECT SET_LED_TEMPLATE STOP_LED_EFFECTS STATUS_*",
    "SET_FILAMENT_SENSOR SET_IDLE_TIMEOUT SET_TEMPERATURE_FAN_TARGET UPDATE_DELAYED_GCODE",
)
_WAITS = (
    "G4 M109 M190 M191 M400 TEMPERATURE_WAIT EXCLUDE_OBJECT_START EXCLUDE_OBJECT_END",
    "M17 M569 M906 M907 G130 SET_TMC_CURRENT",  # the motors' drivers
)
_RETURNS = ("M593 SET_INPUT_SHAPER",)  # shaping, which the stream must turn off again


@dataclass(frozen=True, slots=True)
class Vocabulary:
    """The effects of commands by name, upper case; a name may end in ``*``."""

    names: dict[str, Effect]
    prefixes: tuple[tuple[str, Effect], ...]

    @classmethod
    def with_names(cls, harmless: Iterable[str] = (), returns: Iterable[str] = ()) -> Vocabulary:
        """The usual commands, and those that a user's profile adds or knows better."""
        names = {
            name.upper(): effect
            for texts, effect in (
                (_NONE, Effect.NONE), (_WAITS, Effect.WAITS), (_RETURNS, Effect.RETURNS),
                (harmless, Effect.NONE), (returns, Effect.RETURNS),
            )
            for text in texts
            for name in text.split()
        }  # fmt: skip
        stems = tuple((name[:-1], names.pop(name)) for name in list(names) if name.endswith("*"))
        return cls(names, stems)

    def effect(self, name: str, arguments: bytes = b"") -> Effect:
        """Of a coded command or a macro, its name in upper case."""
        if name in ("G10", "G11") and not arguments.strip():  # with words: a tool's offset
            return Effect.WAITS
        if name == "M486" and b"S" not in arguments.upper():  # names objects; S goes to one
            return Effect.NONE
        if (known := self.names.get(name)) is not None:
            return known
        stems = (effect for stem, effect in self.prefixes if name.startswith(stem))
        return next(stems, Effect.UNKNOWN)


@dataclass(frozen=True, slots=True)
class Dialect:
    """Where firmwares differ in what a command means.

    g90_sets_e: whether G90 makes E absolute and G91 makes it relative, as M82 and M83 do;
    elsewhere E is relative while the file is in G91, and M82 and M83 stay as they were.
    obeyed: which commands that set limits it obeys. keeps_factor: whether M220 B keeps the
    speed factor and M220 R brings it back. zero_feed: whether F0 means nothing, instead of
    being an error. splines: whether it plays G5. cr_ends_lines: whether a carriage return ends
    a line, in a comment too. g92_resets: whether G92 without words makes all coordinates 0,
    instead of nothing. path_acceleration: what M204 asks for, given its words and what held
    before. dwell: seconds that G4 waits, given its words. rejoins: whether
    after an object that it has left out it can be led to where the stream is.
    """

    name: str
    g90_sets_e: bool
    obeyed: frozenset[str]
    keeps_factor: bool
    zero_feed: bool
    splines: bool
    cr_ends_lines: bool
    path_acceleration: Callable[[Words, Accelerations], Accelerations]
    dwell: Callable[[Words], float]
    rejoins: bool = False
    g92_resets: bool = False


def _klipper_acceleration(words: Words, before: Accelerations) -> Accelerations:
    """S, or the lower of P and T where both are given; for every move."""
    if "S" in words:
        return words["S"], words["S"]
    both = min(words["P"], words["T"]) if {"P", "T"} <= words.keys() else before[0]
    return both, both


def _marlin_acceleration(words: Words, before: Accelerations) -> Accelerations:
    """P of printing, T of travel; S of both."""
    if "S" in words:
        return words["S"], words["S"]
    return words.get("P", before[0]), words.get("T", before[1])


def _klipper_dwell(words: Words) -> float:
    """P is in ms; S means nothing."""
    return words.get("P", 0.0) / 1000.0


def _marlin_dwell(words: Words) -> float:
    """S is in s; P, in ms, counts only without it."""
    return words["S"] if "S" in words else words.get("P", 0.0) / 1000.0


KLIPPER = Dialect(
    "klipper", False, frozenset({"M204", LIMITS}), False, False, False, False,
    _klipper_acceleration, _klipper_dwell, rejoins=True, g92_resets=True,
)  # fmt: skip
MARLIN = Dialect(
    "marlin", True, frozenset({"M201", "M203", "M204", "M205"}), True, True, True, True,
    _marlin_acceleration, _marlin_dwell,
)  # fmt: skip
DIALECTS = {each.name: each for each in (KLIPPER, MARLIN)}


def dialect(name: str) -> Dialect:
    """The dialect of the firmware ``name``. Raises HframeError if there is none."""
    if name not in DIALECTS:
        raise HframeError(f"no G-code dialect {name!r}; known are {', '.join(DIALECTS)}")
    return DIALECTS[name]
