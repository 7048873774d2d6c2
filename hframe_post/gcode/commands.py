"""Tables of what the commands of a sliced file mean, by firmware.

A command that is in no table may move the machine or change its modes. It therefore runs with
the user's own limits and modes in force, and the position after it is unknown.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from enum import Enum

from hframe_post.errors import HframeError
from hframe_post.gcode.lexer import Words
from hframe_post.stream.types import Handling

STAMP = b"; processed by hframe-post"
OFF = b"; hframe-post: off"  # a file with this line is not to be converted

Accelerations = tuple[float, float]  # of moves with and without extrusion, mm/s²

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
UNSUPPORTED = {
    "G5.1": "quadratic splines",
    "G53": "machine coordinates",
    **{f"G{code}": "work coordinate systems" for code in range(54, 60)},
    "G92.1": "coordinate resets",
    "G93": "inverse-time feed rates",
    "G95": "feed rates per revolution",
}


class Effect(Enum):
    """Effect on the motion of a command other than a move, mode or limit."""

    NONE = "moves nothing"
    WAITS = "moves nothing, but must happen at rest"
    RETURNS = "may move or change modes, and restores both"
    UNKNOWN = "may move or change modes"
    OTHER_TOOL = "may move, and the model is not that of the tool that prints after it"

    @property
    def handling(self) -> Handling:
        """Return how such a command must reach the machine."""
        if self is Effect.NONE:
            return Handling.CARRY
        return Handling.REST if self is Effect.WAITS else Handling.RELEASE


_NONE = (
    # temperatures, fans, lights, sounds, power
    "M104 M106 M107 M108 M140 M141 M142 M150 M300 M301 M302 M304 M355 M710",
    # messages to a screen, a host or a log
    "M27 M31 M70 M72 M73 M74 M75 M77 M105 M110 M111 M114 M115 M117 M118 M119 M136 M137 M155",
    "M412 M413 M555 M862 M862.1 M862.2 M862.3 M862.4 M862.5 M862.6",
    # settings of the extruder
    "M101 M102 M103 M126 M127 M207 M208 M209 M211 M221 M566 M572 M900",
    # limits of firmwares that are not supported here
    "M202 M320 M592",
    "EXCLUDE_OBJECT_DEFINE SET_PRINT_STATS_INFO SET_PRESSURE_ADVANCE SET_FAN_SPEED SET_PIN",
    "SET_HEATER_TEMPERATURE SET_DISPLAY_TEXT SET_GCODE_VARIABLE RESPOND SET_RETRACTION",
    "SET_LED SET_LED_EFFECT SET_LED_TEMPLATE STOP_LED_EFFECTS STATUS_*",
    "SET_FILAMENT_SENSOR SET_IDLE_TIMEOUT SET_TEMPERATURE_FAN_TARGET UPDATE_DELAYED_GCODE",
)
_WAITS = (
    "G4 M109 M190 M191 M400 TEMPERATURE_WAIT EXCLUDE_OBJECT_START EXCLUDE_OBJECT_END",
    "M17 M569 M906 M907 G130 SET_TMC_CURRENT",  # motor drivers
)
_RETURNS = ("M593 SET_INPUT_SHAPER",)  # input shaping, which the stream must turn off again


@dataclass(frozen=True, slots=True)
class Vocabulary:
    """The effects of commands by name in upper case; prefixes are the names that end in ``*``."""

    names: dict[str, Effect]
    prefixes: tuple[tuple[str, Effect], ...]

    @classmethod
    def with_names(
        cls,
        harmless: Iterable[str] = (),
        returns: Iterable[str] = (),
        other_tools: Iterable[str] = (),
    ) -> Vocabulary:
        """Return the built-in vocabulary with the names that a profile adds or overrides."""
        names = {
            name.upper(): effect
            for texts, effect in (
                (_NONE, Effect.NONE), (_WAITS, Effect.WAITS), (_RETURNS, Effect.RETURNS),
                (harmless, Effect.NONE), (returns, Effect.RETURNS),
                (other_tools, Effect.OTHER_TOOL),
            )
            for text in texts
            for name in text.split()
        }  # fmt: skip
        prefixes = [(name[:-1], names.pop(name)) for name in list(names) if name.endswith("*")]
        return cls(names, tuple(prefixes))

    def effect(self, name: str, arguments: bytes = b"") -> Effect:
        """Return the effect of a coded command or a macro; its name is in upper case."""
        if name in ("G10", "G11") and not arguments.strip():  # with words: a tool's offset
            return Effect.WAITS
        if name == "M486" and b"S" not in arguments.upper():  # names objects; S starts one
            return Effect.NONE
        if (known := self.names.get(name)) is not None:
            return known
        matching = (effect for prefix, effect in self.prefixes if name.startswith(prefix))
        return next(matching, Effect.UNKNOWN)


@dataclass(frozen=True, slots=True)
class Dialect:
    """The meaning of commands where firmwares differ.

    obeyed: the commands that set limits which this firmware obeys.
    accelerations: what M204 sets, given its words and the values before.
    dwell: seconds that G4 waits, given its words.
    g90_sets_e: G90 and G91 set the mode of E as M82 and M83 do. Elsewhere E is relative while
    the file is in G91.
    saves_factor: M220 B saves the speed factor and M220 R restores it.
    ignores_zero_feed: F0 means nothing; elsewhere it is an error.
    splines: G5 is supported. cr_ends_lines: a carriage return ends a line, even in a comment.
    g92_resets: G92 without words sets all coordinates to 0; elsewhere it does nothing.
    rejoins_after_object: after it skips an object, the firmware can be led back to the stream.
    """

    name: str
    obeyed: frozenset[str]
    accelerations: Callable[[Words, Accelerations], Accelerations]
    dwell: Callable[[Words], float]
    g90_sets_e: bool = False
    saves_factor: bool = False
    ignores_zero_feed: bool = False
    splines: bool = False
    cr_ends_lines: bool = False
    g92_resets: bool = False
    rejoins_after_object: bool = False


def _klipper_accelerations(words: Words, before: Accelerations) -> Accelerations:
    """Return S, or the lower of P and T if both are given, for every move."""
    if "S" in words:
        return words["S"], words["S"]
    both = min(words["P"], words["T"]) if {"P", "T"} <= words.keys() else before[0]
    return both, both


def _marlin_accelerations(words: Words, before: Accelerations) -> Accelerations:
    """Return P for printing and T for travel, or S for both."""
    if "S" in words:
        return words["S"], words["S"]
    return words.get("P", before[0]), words.get("T", before[1])


def _klipper_dwell(words: Words) -> float:
    """Return P, which is in ms; S means nothing."""
    return words.get("P", 0.0) / 1000.0


def _marlin_dwell(words: Words) -> float:
    """Return S, or P, which is in ms, if there is no S."""
    return words["S"] if "S" in words else words.get("P", 0.0) / 1000.0


KLIPPER = Dialect(
    "klipper", frozenset({"M204", LIMITS}), _klipper_accelerations, _klipper_dwell,
    g92_resets=True, rejoins_after_object=True,
)  # fmt: skip
MARLIN = Dialect(
    "marlin", frozenset({"M201", "M203", "M204", "M205"}), _marlin_accelerations, _marlin_dwell,
    g90_sets_e=True, saves_factor=True, ignores_zero_feed=True, splines=True, cr_ends_lines=True,
)  # fmt: skip
DIALECTS = {each.name: each for each in (KLIPPER, MARLIN)}


def dialect(name: str) -> Dialect:
    """Return the dialect of a firmware. Raises HframeError if there is none."""
    if name not in DIALECTS:
        raise HframeError(f"unknown G-code dialect {name!r}; choose from {', '.join(DIALECTS)}")
    return DIALECTS[name]
