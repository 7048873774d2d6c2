"""One line of G-code as words: comments, command, checksum, letters with numbers."""

from __future__ import annotations

import math
import re
import shlex
from functools import reduce
from operator import xor
from typing import NamedTuple

from hframe_post.errors import GcodeError

_NUMBER = rb"([-+.\d]+)"
PLAIN_MOVE = re.compile(  # as slicers write it, words in their order; all else is read slowly
    rb"G([01])(?: F%b)?(?: X%b)?(?: Y%b)?(?: Z%b)?(?: E%b)?(?: F%b)?\s*(?:;.*)?$" % ((_NUMBER,) * 6)
)
_BRACKET = re.compile(rb"[()]")
_COMMAND = re.compile(rb"\s*([Nn]\s*\d+\s*)?([GMTgmt])\s*(\d{1,9})(?!\d)(?:\.(\d{1,9})(?!\d))?")
_CHECKSUM = re.compile(rb"\*\s*(\d{1,9})\s*$")
_WORD = re.compile(rb"([A-Za-z])\s*([-+]?(?:\d+\.?\d*|\.\d+))")
_EXTENDED = re.compile(rb"\s*(?:[Nn]\d+\s*)?[A-Za-z_]\w+(?:\s+|$)([^#*;]*)")


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
    """The coded command of a line, None where it has none.

    Raises GcodeError where the checksum of a numbered line does not hold.
    """
    body = uncommented(line.text)
    match = _COMMAND.match(body)
    if match is None:
        return None
    numbered, letter, code, sub = match.groups()
    arguments = body[match.end() :]
    if (checksum := _CHECKSUM.search(arguments)) is not None:
        # without a number a line has no checksum: it may be a text, and firmware ignores it
        if numbered and reduce(xor, body[: body.rindex(b"*")]) != int(checksum[1]):
            raise line.error("the checksum does not hold")
        arguments = arguments[: checksum.start()]
    name = f"{letter.decode().upper()}{int(code)}" + (f".{int(sub)}" if sub else "")
    return Command(name, arguments)


def numbers(line: Line, arguments: bytes, letters: str) -> dict[str, float]:
    """Letter → number of a command's arguments; only ``letters`` may occur, each once."""
    words = _words(arguments)
    found = dict(words)
    for key, _ in words:
        if key not in letters:
            raise line.error(f"the word {key} is not understood here")
    if len(found) < len(words):
        keys = [key for key, _ in words]
        twice = next(key for key in keys if keys.count(key) > 1)
        raise line.error(f"the word {twice} occurs twice")
    if _WORD.sub(b"", arguments).strip():
        raise line.error("a word or number cannot be read")
    return _finite(line, found)


def numbers_among(line: Line, arguments: bytes, letters: str) -> dict[str, float]:
    """Letter → number of those words that are asked for, whatever else there is."""
    return _finite(line, {key: number for key, number in _words(arguments) if key in letters})


def _words(arguments: bytes) -> list[tuple[str, float]]:
    """Letters, upper case, and numbers in their order."""
    found = _WORD.findall(arguments)
    return [(letter.decode().upper(), float(digits)) for letter, digits in found]


def plain_words(line: Line, groups: tuple[bytes | None, ...]) -> tuple[float | None, ...]:
    """F, x, y, z and e of what PLAIN_MOVE has matched; None where there is none."""
    _, f, *places, f_last = groups
    try:
        return tuple(float(word) if word else None for word in (f or f_last, *places))
    except ValueError:
        raise line.error("a number cannot be read") from None


def parameters(line: Line, names: tuple[str, ...]) -> dict[str, float]:
    """NAME → number of those parameters of a Klipper command that are asked for.

    As Klipper reads them: quotes as in a shell, any number that Python knows, names in
    either case, the last of equals.
    """
    match = _EXTENDED.match(line.text)
    found = {}
    try:
        text = match[1].decode("latin-1") if match else ""
        quoted = any(mark in text for mark in "'\"\\")  # few are, and splitting those is slow
        for part in shlex.split(text) if quoted else text.split():
            name, equals, value = part.partition("=")
            if not equals:
                raise line.error(f"{part!r} is no NAME=value")
            if name.upper() in names:
                found[name.upper()] = float(value)
    except ValueError:
        raise line.error("a parameter cannot be read") from None
    return _finite(line, found)


def _finite(line: Line, found: dict[str, float]) -> dict[str, float]:
    if not all(map(math.isfinite, found.values())):
        raise line.error("a number is out of all bounds")
    return found
