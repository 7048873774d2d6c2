"""One line of G-code as words: comments, command, checksum, letters with numbers."""

from __future__ import annotations

import math
import re
from functools import reduce
from operator import xor

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


def uncommented(text: bytes) -> bytes:
    """The line without comments of either form, nested ones included."""
    while (shorter := _COMMENT.sub(b" ", text)) != text:
        text = shorter
    return text


def command(number: int, text: bytes) -> tuple[str, bytes] | None:
    """Name (``G1``, ``M106``, ``G92.1``) and arguments of a coded command, else None.

    Raises GcodeError where a checksum does not hold.
    """
    body = uncommented(text)
    match = _COMMAND.match(body)
    if match is None:
        return None
    arguments = body[match.end() :]
    if (checksum := _CHECKSUM.search(arguments)) is not None:
        if reduce(xor, body[: body.rindex(b"*")]) != int(checksum[1]):
            raise GcodeError("the checksum does not hold", number, text)
        arguments = arguments[: checksum.start()]
    letter, code, sub = match.groups()
    name = f"{letter.decode().upper()}{int(code)}" + (f".{int(sub)}" if sub else "")
    return name, arguments


def numbers(number: int, text: bytes, arguments: bytes, letters: str) -> dict[str, float]:
    """Letter → number of a command's arguments; only ``letters`` may occur, each once."""
    found: dict[str, float] = {}
    for letter, digits in _WORD.findall(arguments):
        key = letter.decode().upper()
        if key in found:
            raise GcodeError(f"the word {key} occurs twice", number, text)
        if key not in letters:
            raise GcodeError(f"the word {key} is not understood here", number, text)
        found[key] = float(digits)
    if _WORD.sub(b"", arguments).strip():
        raise GcodeError("a word or number cannot be read", number, text)
    if not all(map(math.isfinite, found.values())):
        raise GcodeError("a number is out of all bounds", number, text)
    return found


def parameters(number: int, text: bytes) -> dict[str, float]:
    """NAME → number of a Klipper command's NAME=value arguments; others are left out."""
    try:
        return {k.decode().upper(): float(v) for k, v in _PARAMETER.findall(uncommented(text))}
    except ValueError:
        raise GcodeError("a number cannot be read", number, text) from None
