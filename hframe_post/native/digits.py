"""Numbers as text, many at once: lines of motion in C and in numpy, from tables of digits."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from hframe_post.arrays import Array, Integers
from hframe_post.errors import HframeError
from hframe_post.native import compiled, kernels

Bytes = NDArray[np.uint8]
MINUS, ZERO = b"-0"
WHOLE_DIGITS = 5  # before the point; a printer has no use for more
TOO_LONG = "a coordinate, filament length or feed rate is too long to be written"
GROUP = 4  # digits looked up at once
MOVES, STANDS, BEGINS, JUMPS = range(4)  # kinds of lines of motion


def motion_lines(
    at: Integers, feeds: Integers, kinds: Bytes, feed: int, decimals: tuple[int, ...],
    between: Integers, lines: bytes,
) -> tuple[bytes, Integers]:  # fmt: skip
    """Return n lines of G1 from place to place, with others between them.

    between (m, 3): of each other the line that it precedes, ascending, and where it begins and ends
    in ``lines``. Returns the text, and where in it each of the others begins, (m,).

    at (n + 1, 4): x, y, z, e; feeds (n,): F; both in units of 10^−decimals (5,). feed: F before
    the first line. A word is written where it changes; E is a difference. kinds (n,): MOVES, or F
    is written in any case (STANDS), as are x and y (BEGINS), or there is no line (JUMPS). No
    exponent, no negative zero, no trailing zeros. Raises HframeError for numbers
    with more than WHOLE_DIGITS before the point, or from 2³² units on.
    """
    n, m = len(feeds), len(between)
    # bytes of a line of motion, at most: five words of up to 10 digits
    text = np.empty(n * 80 + int((between[:, 2] - between[:, 1]).sum()), np.uint8)
    begun, numbers = np.empty(m, np.int64), (_row(decimals), _longest(decimals))
    own = at, feeds, kinds, feed
    size = kernels.motion_lines(*own, *numbers, between, lines, text, begun)
    if size < 0:
        raise HframeError(TOO_LONG)
    return text[:size].tobytes(), begun


@compiled
def progress_lines(
    text: Bytes, at: Integers, elapsed: Array, before: float, after: float, room: int, /
) -> Integers:
    """Change the times in lines of M73 and ;TIME_ELAPSED; return the other lines, (m,), which stay.

    text: with the lines at places (k, 2), and ``room`` blanks behind each. elapsed (k,), before,
    after: see ``writers.print_time.with_times``.
    """


@cache
def _row(decimals: tuple[int, ...]) -> Integers:
    return np.array(decimals)


@cache
def _longest(decimals: tuple[int, ...]) -> Integers:
    return np.array([*map(least_too_long, decimals)])


def least_too_long(decimals: int) -> int:
    """Return the least number, in units of 10^−decimals, that is too long to be written."""
    return int(min(10 ** (WHOLE_DIGITS + decimals), 2**32))


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
