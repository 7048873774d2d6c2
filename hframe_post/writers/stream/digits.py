"""Rows of numbers as G-code text, many at once, from tables of digits."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from hframe_post.arrays import Array, Flags, Integers
from hframe_post.errors import HframeError
from hframe_post.native.kernels import kernel

Bytes = NDArray[np.uint8]
MINUS, POINT, ZERO = b"-.0"
WHOLE_DIGITS = 5  # before the point; a printer has no use for more
ROOM = 27  # bytes of a word, at most: 2³² has 10 digits, no number has more than 20 decimals
GROUP = 4  # digits looked up at once
LARGEST = 1e15  # whose digits a float still knows


def command_lines(
    command: bytes, letters: bytes, values: Integers, decimals: tuple[int, ...], shown: Flags
) -> tuple[bytes, Integers]:
    """n lines of a command with w words each: their text, and where each ends in it (n,).

    values (w, n) and shown (w, n) as for ``word``, with a letter and decimals for each row.
    """
    if (compiled := kernel("command_lines")) is None:
        return _command_lines(command, letters, values, decimals, shown)
    for row, places in zip(values, decimals, strict=True):
        _check(row, places)
    w, n = values.shape
    text, ends = np.empty(n * (len(command) + w * ROOM + 1), np.uint8), np.empty(n, np.int64)
    size = compiled(
        command, letters, w, n, np.ascontiguousarray(values), np.array(decimals, np.int64),
        np.ascontiguousarray(shown).view(np.uint8), text, ends,
    )  # fmt: skip
    return text[:size].tobytes(), ends


def _command_lines(
    command: bytes, letters: bytes, values: Integers, decimals: tuple[int, ...], shown: Flags
) -> tuple[bytes, Integers]:
    words = [
        word(b" %c" % letter, row, places, seen)
        for letter, row, places, seen in zip(letters, values, decimals, shown, strict=True)
    ]
    return lines(command, words)


def _check(values: Integers, decimals: int) -> None:
    longest = 10.0 ** (WHOLE_DIGITS + decimals)
    if np.abs(values.astype(np.float64)).max(initial=0.0) >= min(longest, 2.0**32):
        raise HframeError("a coordinate, filament length or feed rate is too long to be written")


def word(letter: bytes, values: Integers, decimals: int, shown: Flags) -> Bytes:
    """`` X-12.5`` for each of n values in units of 10^−decimals: (n, width), 0 where nothing.

    No exponent, no negative zero, no trailing zeros; rows not ``shown`` are all 0. Raises
    HframeError for numbers with more than WHOLE_DIGITS before the point, or from 2³² on.
    """
    n, width = len(values), len(letter)
    _check(values, decimals)
    whole, fraction = np.divmod(np.abs(values).astype(np.uint32), np.uint32(10**decimals))
    top = int(whole.max(initial=0))
    digits = 3 if top < 1000 else WHOLE_DIGITS
    text = np.empty((n, width + 1 + digits + 1 + decimals), dtype=np.uint8)
    text[:, :width] = np.frombuffer(letter, dtype=np.uint8)
    text[:, width] = np.where(values < 0, MINUS, 0)
    text[:, width + 1 : width + 1 + digits] = _wholes(digits)[whole]
    text[:, width + 1 + digits :] = _fractions(decimals)[fraction]
    text[~shown] = 0
    return text


def lines(command: bytes, words: list[Bytes]) -> tuple[bytes, Integers]:
    """``command`` and its words as lines: their text, and where each ends in it (n,)."""
    n = len(words[0])
    head = np.tile(np.frombuffer(command, dtype=np.uint8), (n, 1))
    end = np.full((n, 1), ord("\n"), dtype=np.uint8)
    table = np.concatenate([head, *words, end], axis=1)
    visible = table != 0
    return table[visible].tobytes(), np.cumsum(visible.sum(axis=1))


def rows(columns: list[Bytes]) -> bytes:
    """Columns of text (n, width each) side by side; bytes that are 0 are left out."""
    table = np.concatenate(columns, axis=1)
    return table.tobytes() if table.all() else table[table != 0].tobytes()


def fixed(values: Array, decimals: int) -> Bytes:
    """Each of n numbers with so many decimals: (n, width), 0 where nothing is to be seen.

    No exponent, no negative zero. Raises HframeError for what has no 15 digits or is no number.
    """
    units = np.rint(values * 10.0**decimals)
    if not (np.abs(units) < LARGEST).all():
        raise HframeError("a number is too long to be written")
    before, after = np.divmod(np.abs(units).astype(np.int64), 10**decimals)
    sign = np.where(units < 0.0, MINUS, 0).astype(np.uint8)
    return np.concatenate(
        [sign[:, None], whole(before), column(b".", len(values)), padded(after, decimals)], axis=1
    )


def column(text: bytes, n: int) -> Bytes:
    """The same text in n rows, (n, len(text))."""
    return np.tile(np.frombuffer(text, dtype=np.uint8), (n, 1))


def whole(values: Integers) -> Bytes:
    """Each of n whole numbers, none negative: (n, width), 0 in place of leading zeros."""
    greatest = int(values.max(initial=0))
    width = len(str(greatest))
    text = padded(values, width)
    if int(values.min(initial=greatest)) < 10 ** (width - 1):
        for place in range(1, width):
            text[values < 10**place, width - 1 - place] = 0
    return text


def padded(values: Integers, width: int) -> Bytes:
    """Each of n whole numbers, none negative and all below 10^width: (n, width) with zeros."""
    text = np.empty((len(values), -(-width // GROUP) * GROUP), dtype=np.uint8)
    for start in range(text.shape[1] - GROUP, -1, -GROUP):
        left = values // 10**GROUP if start else np.zeros_like(values)
        group = text[:, start : start + GROUP].view(np.uint32)
        group[:, 0] = _groups()[values - left * 10**GROUP]
        values = left
    return text[:, text.shape[1] - width :]


@cache
def _groups() -> NDArray[np.uint32]:
    """Every number of GROUP digits as one word of memory, (10^GROUP,)."""
    return _digits(GROUP).view(np.uint32)[:, 0]


@cache
def _wholes(digits: int) -> Bytes:
    """Every whole number of so many digits without leading zeros, (10^digits, digits)."""
    table, visible = _digits(digits), np.zeros(10**digits, dtype=bool)
    for place in range(digits - 1):
        visible |= table[:, place] != ZERO
        table[~visible, place] = 0
    return table


@cache
def _fractions(digits: int) -> Bytes:
    """The point and every fraction without trailing zeros, (10^digits, 1 + digits)."""
    table = np.full((10**digits, 1 + digits), POINT, dtype=np.uint8)
    table[:, 1:] = _digits(digits)
    visible = np.zeros(10**digits, dtype=bool)
    for place in range(digits, -1, -1):
        if place:
            visible |= table[:, place] != ZERO
        table[~visible, place] = 0
    return table


def _digits(digits: int) -> Bytes:
    """Every number of so many digits, (10^digits, digits)."""
    numbers = np.arange(10**digits)[:, None] // 10 ** np.arange(digits - 1, -1, -1)
    return (ZERO + numbers % 10).astype(np.uint8)
