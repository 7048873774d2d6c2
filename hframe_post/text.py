"""Rows of numbers as G-code text, many at once, from tables of digits."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from hframe_post.arrays import Flags, Integers
from hframe_post.errors import HframeError

Bytes = NDArray[np.uint8]
MINUS, POINT, ZERO = b"-.0"
WHOLE_DIGITS = 5  # before the point; a printer has no use for more


def word(letter: bytes, values: Integers, decimals: int, shown: Flags) -> Bytes:
    """`` X-12.5`` for each of n values in units of 10^−decimals: (n, width), 0 where nothing.

    No exponent, no negative zero, no trailing zeros; rows not ``shown`` are all 0. Raises
    HframeError for numbers with more than WHOLE_DIGITS before the point, or from 2³² on.
    """
    n, width = len(values), len(letter)
    longest = 10.0 ** (WHOLE_DIGITS + decimals)
    if np.abs(values.astype(np.float64)).max(initial=0.0) >= min(longest, 2.0**32):
        raise HframeError("a coordinate, filament length or feed rate is too long to be written")
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
