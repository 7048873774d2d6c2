"""Rows of numbers as G-code text, many at once."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hframe_post.arrays import Flags, Integers

Bytes = NDArray[np.uint8]
MINUS, POINT, ZERO = b"-.0"


def word(letter: bytes, values: Integers, decimals: int, shown: Flags) -> Bytes:
    """`` X-12.5`` for each of n values in units of 10^−decimals: (n, width), 0 where nothing.

    No exponent, no negative zero, no trailing zeros; rows not ``shown`` are all 0.
    """
    magnitude = np.abs(values)
    digits = max(len(str(int(magnitude.max(initial=0)))), decimals + 1)
    whole = digits - decimals
    text = np.zeros((len(values), len(letter) + 1 + digits + 1), dtype=np.uint8)
    text[:, : len(letter)] = np.frombuffer(letter, dtype=np.uint8)
    start = len(letter)
    text[:, start] = np.where(values < 0, MINUS, 0)
    rest, tail = magnitude, np.zeros(len(values), dtype=bool)
    for place in range(digits):  # from the last digit to the first
        rest, digit = np.divmod(rest, 10)
        if place < decimals:
            tail |= digit != 0
            visible = tail
        else:
            visible = (digit != 0) | (rest != 0) if place > decimals else np.ones_like(tail)
        column = start + 1 + digits - place - (place >= decimals)
        text[:, column] = np.where(visible, ZERO + digit, 0)
    if decimals:
        text[:, start + 1 + whole] = np.where(tail, POINT, 0)
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
