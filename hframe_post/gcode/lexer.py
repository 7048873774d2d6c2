"""One line of G-code as words: comments, command, checksum, letters with numbers."""

from __future__ import annotations

import math
import re
import shlex
from functools import reduce
from operator import xor
from typing import NamedTuple

from hframe_post.errors import GcodeError

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
    body = uncommented(line.text)
    match = _COMMAND.match(body)
    if match is None:
        return None
    numbered, letter, code, sub = match.groups()
    arguments = body[match.end() :]
    if b"*" in arguments and (checksum := _CHECKSUM.search(arguments)) is not None:
        # Without a line number there is no checksum: it may be text, and firmware ignores it.
        if numbered and reduce(xor, body[: body.rindex(b"*")]) != int(checksum[1]):
            raise line.error("the checksum is wrong")
        arguments = arguments[: checksum.start()]
    name = f"{letter.decode().upper()}{int(code)}" + (f".{int(sub)}" if sub else "")
    return Command(name, arguments)


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


def _finite(line: Line, found: dict[str, float]) -> dict[str, float]:
    if not all(map(math.isfinite, found.values())):
        raise line.error("a number is too large")
    return found
