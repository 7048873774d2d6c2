"""One line of G-code as words: comments, command, checksum, letters with numbers."""

from __future__ import annotations

import math
import re
from functools import reduce
from operator import xor
from typing import NamedTuple

from hframe_post.errors import GcodeError

_NUMBER = rb"([-+.\d]+)"
PLAIN_MOVE = re.compile(  # as slicers write it, words in their order; all else is read slowly
    rb"G([01])(?: F%b)?(?: X%b)?(?: Y%b)?(?: Z%b)?(?: E%b)?(?: F%b)?\s*(?:;.*)?$" % ((_NUMBER,) * 6)
)
_COMMENT = re.compile(rb"\([^()]*\)|;.*")
_COMMAND = re.compile(rb"\s*(?:[Nn]\s*\d+\s*)?([GMTgmt])\s*(\d+)(?:\.(\d+))?(?![\d_])")
_CHECKSUM = re.compile(rb"\*\s*(\d+)\s*$")
_WORD = re.compile(rb"([A-Za-z])\s*([-+]?(?:\d+\.?\d*|\.\d+))")
_PARAMETER = re.compile(rb"([A-Z_]+)\s*=\s*([-+.\d]+)", re.IGNORECASE)


class Line(NamedTuple):
    """A line of the file: its number, from 1, and its text without the line feed.

    A tuple, since one is made for every line of files of a million.
    """

    number: int
    text: bytes

    def error(self, cause: str) -> GcodeError:
        """The error that names this line."""
        return GcodeError(cause, self.number, self.text)


class Command(NamedTuple):
    """A coded command: its name (``G1``, ``M106``, ``G92.1``) and the text of its words."""

    name: str
    arguments: bytes


def uncommented(text: bytes) -> bytes:
    """The line without comments of either form, nested ones included."""
    while (shorter := _COMMENT.sub(b" ", text)) != text:
        text = shorter
    return text


def command(line: Line) -> Command | None:
    """The coded command of a line, None where it has none.

    Raises GcodeError where a checksum does not hold.
    """
    body = uncommented(line.text)
    match = _COMMAND.match(body)
    if match is None:
        return None
    arguments = body[match.end() :]
    if (checksum := _CHECKSUM.search(arguments)) is not None:
        if reduce(xor, body[: body.rindex(b"*")]) != int(checksum[1]):
            raise line.error("the checksum does not hold")
        arguments = arguments[: checksum.start()]
    letter, code, sub = match.groups()
    name = f"{letter.decode().upper()}{int(code)}" + (f".{int(sub)}" if sub else "")
    return Command(name, arguments)


def numbers(line: Line, arguments: bytes, letters: str) -> dict[str, float]:
    """Letter → number of a command's arguments; only ``letters`` may occur, each once."""
    found: dict[str, float] = {}
    for letter, digits in _WORD.findall(arguments):
        key = letter.decode().upper()
        if key in found:
            raise line.error(f"the word {key} occurs twice")
        if key not in letters:
            raise line.error(f"the word {key} is not understood here")
        found[key] = float(digits)
    if _WORD.sub(b"", arguments).strip():
        raise line.error("a word or number cannot be read")
    if not all(map(math.isfinite, found.values())):
        raise line.error("a number is out of all bounds")
    return found


def parameters(line: Line) -> dict[str, float]:
    """NAME → number of a Klipper command's NAME=value arguments; others are left out."""
    pairs = _PARAMETER.findall(uncommented(line.text))
    try:
        return {name.decode().upper(): float(value) for name, value in pairs}
    except ValueError:
        raise line.error("a number cannot be read") from None
