"""Numbers as text, many at once, from tables of digits."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from hframe_post.arrays import Array, Flags, Integers
from hframe_post.errors import HframeError
from hframe_post.native import kernel

Bytes = NDArray[np.uint8]
MINUS, ZERO = b"-0"
WHOLE_DIGITS = 5  # before the point; a printer has no use for more
GROUP = 4  # digits looked up at once


def command_lines(
    command: bytes, letters: bytes, values: Integers, decimals: tuple[int, ...], shown: Flags
) -> tuple[bytes, Integers]:
    """Return n lines of a command with w words each, and where each ends in the text (n,).

    values (w, n): in units of 10^−decimals (w,), each after its letter (w,). shown (w, n): whether
    the word is written. No exponent, no negative zero, no trailing zeros. Raises HframeError for
    numbers with more than WHOLE_DIGITS before the point, or from 2³² units on.
    """
    for row, places in zip(values, decimals, strict=True):
        longest = min(10.0 ** (WHOLE_DIGITS + places), 2.0**32)
        if np.abs(row.astype(np.float64)).max(initial=0.0) >= longest:
            cause = "a coordinate, filament length or feed rate is too long to be written"
            raise HframeError(cause)
    if (compiled := kernel("command_lines")) is None:
        return _command_lines(command, letters, values, decimals, shown)
    w, n = values.shape
    room = 27  # bytes of a word, at most: 2³² has 10 digits, no number has more than 20 decimals
    text, ends = np.empty(n * (len(command) + w * room + 1), np.uint8), np.empty(n, np.int64)
    size = compiled(
        command, letters, w, n, np.ascontiguousarray(values), np.array(decimals, np.int64),
        np.ascontiguousarray(shown), text, ends,
    )  # fmt: skip
    return text[:size].tobytes(), ends


def _command_lines(
    command: bytes, letters: bytes, values: Integers, decimals: tuple[int, ...], shown: Flags
) -> tuple[bytes, Integers]:
    n = values.shape[1]
    columns = [column(command, n)]
    for letter, row, places, seen in zip(letters, values, decimals, shown, strict=True):
        word = np.concatenate([column(b" %c" % letter, n), number(row, places, trim=True)], axis=1)
        word[~seen] = 0
        columns.append(word)
    table = np.concatenate([*columns, column(b"\n", n)], axis=1)
    visible = table != 0
    return table[visible].tobytes(), np.cumsum(visible.sum(axis=1))


def rows(columns: list[Bytes]) -> bytes:
    """Return columns of text (n, width each) side by side, without bytes that are 0."""
    table = np.concatenate(columns, axis=1)
    return table.tobytes() if table.all() else table[table != 0].tobytes()


def column(text: bytes, n: int) -> Bytes:
    """Return the same text in n rows, (n, len(text))."""
    return np.tile(np.frombuffer(text, dtype=np.uint8), (n, 1))


def fixed(values: Array, decimals: int) -> Bytes:
    """Return n numbers with this many decimals: (n, width), 0 where nothing is written.

    No exponent, no negative zero. Raises HframeError for numbers of more than 15 digits and for
    NaN.
    """
    units = np.rint(values * 10.0**decimals)
    if not (np.abs(units) < 1e15).all():
        raise HframeError("a number is too long to be written")
    return number(units.astype(np.int64), decimals)


def number(units: Integers, decimals: int, trim: bool = False) -> Bytes:
    """Return n numbers in units of 10^−decimals: (n, width), 0 where nothing is written.

    trim: without trailing zeros of the fraction.
    """
    before, after = np.divmod(np.abs(units), 10**decimals)
    sign = np.where(units < 0, MINUS, 0).astype(np.uint8)
    point, fraction = column(b"." if decimals else b"", len(units)), _padded(after, decimals)
    if trim and decimals:
        seen = np.logical_or.accumulate(fraction[:, ::-1] != ZERO, axis=1)[:, ::-1]
        fraction[~seen] = 0
        point[~seen[:, 0]] = 0
    return np.concatenate([sign[:, None], whole(before), point, fraction], axis=1)


def whole(values: Integers) -> Bytes:
    """Return n whole numbers, none negative: (n, width), 0 in place of leading zeros."""
    greatest = int(values.max(initial=0))
    width = len(str(greatest))
    text = _padded(values, width)
    if int(values.min(initial=greatest)) < 10 ** (width - 1):
        for place in range(1, width):
            text[values < 10**place, width - 1 - place] = 0
    return text


def _padded(values: Integers, width: int) -> Bytes:
    """Return n whole numbers, none negative and all below 10^width: (n, width) with zeros."""
    text = np.empty((len(values), -(-width // GROUP) * GROUP), dtype=np.uint8)
    for start in range(text.shape[1] - GROUP, -1, -GROUP):
        left = values // 10**GROUP if start else np.zeros_like(values)
        group = text[:, start : start + GROUP].view(np.uint32)
        group[:, 0] = _groups()[values - left * 10**GROUP]
        values = left
    return text[:, text.shape[1] - width :]


@cache
def _groups() -> NDArray[np.uint32]:
    """Return every number of GROUP digits as one word of memory, (10^GROUP,)."""
    digits = np.arange(10**GROUP)[:, None] // 10 ** np.arange(GROUP - 1, -1, -1)
    return (ZERO + digits % 10).astype(np.uint8).view(np.uint32)[:, 0]
