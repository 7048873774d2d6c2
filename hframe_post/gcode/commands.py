"""Tables of what the commands of a sliced file mean, whatever the firmware.

A command that is in no table may move the machine or change its modes. It therefore runs with
the user's own limits and modes in force, and the position after it is unknown.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum

from hframe_post.stream.types import Handling

STAMP = b"; processed by hframe-post"
OFF = b"; hframe-post: off"  # a file with this line is not to be converted

MOTION_WORDS = {
    "G0": "XYZEF",
    "G1": "XYZEF",
    "G2": "XYZEFIJKR",
    "G3": "XYZEFIJKR",
    "G5": "XYZEFIJPQ",
    "G92": "XYZE",
}
MODAL = frozenset({"G90", "G91", "M82", "M83", "G20", "G21", "G17", "G18", "G19"})
LIMITS = "SET_VELOCITY_LIMIT"
LIMIT_WORDS = {"M201": "XYZE", "M203": "XYZE", "M204": "PTS", "M205": "XYJ", "M220": "S"}
LIMIT_PARAMETERS = (
    "VELOCITY",
    "ACCEL",
    "SQUARE_CORNER_VELOCITY",
    "MINIMUM_CRUISE_RATIO",
    "ACCEL_TO_DECEL",
)
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
    "M486 EXCLUDE_OBJECT_DEFINE EXCLUDE_OBJECT_START EXCLUDE_OBJECT_END",
    "SET_PRINT_STATS_INFO SET_PRESSURE_ADVANCE SET_FAN_SPEED SET_PIN",
    "SET_HEATER_TEMPERATURE SET_DISPLAY_TEXT SET_GCODE_VARIABLE RESPOND SET_RETRACTION",
    "SET_LED SET_LED_EFFECT SET_LED_TEMPLATE STOP_LED_EFFECTS STATUS_*",
    "SET_FILAMENT_SENSOR SET_IDLE_TIMEOUT SET_TEMPERATURE_FAN_TARGET UPDATE_DELAYED_GCODE",
)
_WAITS = (
    "G4 M109 M190 M191 M400 TEMPERATURE_WAIT",
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
        if (known := self.names.get(name)) is not None:
            return known
        matching = (effect for prefix, effect in self.prefixes if name.startswith(prefix))
        return next(matching, Effect.UNKNOWN)
