"""Lines of G-code as words, and what commands mean, whatever the firmware."""

from __future__ import annotations

import math
import re
import shlex
from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum
from functools import reduce
from operator import xor
from typing import NamedTuple

from hframe_post.errors import GcodeError
from hframe_post.stream.marks import recent
from hframe_post.stream.types import Handling

Words = dict[str, float]  # letter → number

IGNORED = "DHLPQRST"  # in moves; A, B, C, I, J, K, U, V, W may be axes
_BLANK_OR_IGNORED = b" \t\r\v\f" + IGNORED.encode() + IGNORED.lower().encode()

_BRACKET = re.compile(rb"[()]")
_COMMAND = re.compile(rb"\s*([Nn]\s*\d+\s*)?([GMTgmt])\s*(\d{1,9})(?!\d)(?:\.(\d{1,9})(?!\d))?")
_CHECKSUM = re.compile(rb"\*\s*(\d{1,9})\s*$")
_WORD = re.compile(rb"([A-Za-z])\s*([-+]?(?:\d+\.?\d*|\.\d+))")
_EXTENDED = re.compile(rb"\s*(?:[Nn]\d+\s*)?[A-Za-z_]\w+(?:\s+|$)([^#*;]*)")


class Line(NamedTuple):
    """A line of the file: its number, from 1, and its text without the line feed."""

    number: int
    text: bytes

    def error(self, cause: str) -> GcodeError:
        return GcodeError(cause, self.number, self.text)


class Command(NamedTuple):
    """A coded command: its name (``G1``, ``M106``, ``G92.1``) and the text of its words."""

    name: str
    arguments: bytes


def uncommented(text: bytes) -> bytes:
    """Return the line without comments of either form, nested ones included."""
    if b"(" not in text:
        return text.partition(b";")[0]
    opened: list[int] = []
    closed: list[tuple[int, int]] = []  # outermost pairs so far, ascending
    for bracket in _BRACKET.finditer(text):
        if bracket[0] == b"(":
            opened.append(bracket.start())
        elif opened:
            start = opened.pop()
            while closed and closed[-1][0] > start:
                closed.pop()
            closed.append((start, bracket.end()))
    kept, after = [], 0
    for start, end in closed:
        kept.append(text[after:start])
        if b";" in kept[-1]:
            break
        after = end
    else:
        kept.append(text[after:])
    return b" ".join(kept).partition(b";")[0]


def command(line: Line) -> Command | None:
    """Return the coded command (G, M or T) of a line, or None. Raises GcodeError (checksum)."""
    text = line.text
    coded, right = _coded(text)
    if not right:
        raise line.error("the checksum is wrong")
    return coded


@recent
def _coded(text: bytes) -> tuple[Command | None, bool]:
    """Return the coded command of a line's text, or None, and whether its checksum is right."""
    body = uncommented(text)
    match = _COMMAND.match(body)
    if match is None:
        return None, True
    numbered, letter, code, sub = match.groups()
    arguments = body[match.end() :]
    if b"*" in arguments and (checksum := _CHECKSUM.search(arguments)) is not None:
        # Without a line number there is no checksum: it may be text, and firmware ignores it.
        if numbered and reduce(xor, body[: body.rindex(b"*")]) != int(checksum[1]):
            return None, False
        arguments = arguments[: checksum.start()]
    name = f"{letter.decode().upper()}{int(code)}" + (f".{int(sub)}" if sub else "")
    return Command(name, arguments), True


def name_and_arguments(line: Line) -> tuple[str, bytes]:
    """Return a command's or macro's name in upper case, or "", and a coded one's arguments."""
    if (coded := command(line)) is not None:
        return coded
    words = uncommented(line.text).split(maxsplit=1)
    return (words[0].decode("latin-1").upper() if words else ""), b""


def numbers(line: Line, arguments: bytes, letters: str) -> Words:
    """Return letter → number of a command's arguments.

    Raises GcodeError if there is anything but ``letters`` with numbers, each at most once, and
    words that firmware ignores in moves.
    """
    found: Words = {}
    for word, digits in _WORD.findall(arguments):
        letter = word.decode().upper()
        if letter in IGNORED and letter not in letters:
            continue
        if letter not in letters:
            raise line.error(f"unexpected word {letter}")
        if letter in found:
            raise line.error(f"the word {letter} occurs twice")
        found[letter] = float(digits)
    if _WORD.sub(b"", arguments).strip(_BLANK_OR_IGNORED):
        raise line.error("a word or number cannot be read")
    return _finite(line, found)


def numbers_among(line: Line, arguments: bytes, letters: str) -> Words:
    """Return letter → number of those words that are asked for; ignore the others."""
    found = ((word.decode().upper(), float(digits)) for word, digits in _WORD.findall(arguments))
    return _finite(line, {letter: number for letter, number in found if letter in letters})


def parameters(line: Line, names: tuple[str, ...]) -> dict[str, float]:
    """Return NAME → number of those parameters of a Klipper command that are asked for.

    They are read as Klipper reads them: quotes as in a shell, any number that Python accepts, names
    in either case, the last one of equals. Raises GcodeError.
    """
    match = _EXTENDED.match(line.text)
    found = {}
    try:
        text = match[1].decode("latin-1") if match else ""
        quoted = any(mark in text for mark in "'\"\\")  # rare, and slow to split
        for part in shlex.split(text) if quoted else text.split():
            name, equals, value = part.partition("=")
            if not equals:
                raise line.error(f"expected NAME=value instead of {part!r}")
            if name.upper() in names:
                found[name.upper()] = float(value)
    except ValueError:
        raise line.error("a parameter cannot be read") from None
    return _finite(line, found)


def limit_words(line: Line, name: str, arguments: bytes) -> dict[str, float]:
    """Return the numbers of a command that sets limits or the speed factor, by word."""
    if name == LIMITS:
        return parameters(line, LIMIT_PARAMETERS)
    return numbers_among(line, arguments, LIMIT_WORDS[name])


def _finite(line: Line, found: dict[str, float]) -> dict[str, float]:
    if not all(map(math.isfinite, found.values())):
        raise line.error("a number is too large")
    return found


# ----------------------------------------------------------------------
# Tables of what the commands of a sliced file mean, whatever the firmware.
#
# A command that is in no table may move the machine or change its modes. It therefore runs with
# the user's own limits and modes in force, and the position after it is unknown.

STAMP = b"; processed by hframe-post"
OFF = b"; hframe-post: off"  # a file with this line is not to be converted
# words of the two above and of labels of objects, and of comments and messages that say a time
COMMENT_WORDS, TIME_WORDS = b"hframe-post|printing|mesh:", b"time|left|remaining"

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
LIMIT_WORDS = {"M201": "XYZE", "M203": "XYZE", "M204": "PRTS", "M205": "XYJ", "M220": "S"}
LIMIT_PARAMETERS = (
    "VELOCITY",
    "ACCEL",
    "SQUARE_CORNER_VELOCITY",
    "MINIMUM_CRUISE_RATIO",
    "ACCEL_TO_DECEL",
)
# commands that move nothing, and of which the reader or a later stage keeps the words
FOLLOWED = frozenset({
    *MOTION_WORDS, *MODAL, LIMITS, *LIMIT_WORDS, "M211", "M486", "M900",
    "SET_PRESSURE_ADVANCE", "EXCLUDE_OBJECT_START", "EXCLUDE_OBJECT_END",
})  # fmt: skip
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
