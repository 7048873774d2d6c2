"""What tests of compiled loops share: comparing with numpy, in which sums are in order."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from hframe_post import native
from hframe_post.arrays import Array
from hframe_post.native import stop
from hframe_post.native.linear import product


def same(one: Any, other: Any) -> None:
    """Compare arrays, and tuples and lists of them, bit by bit."""
    assert type(one) is type(other)
    if isinstance(one, tuple | list):
        assert len(one) == len(other)
        for a, b in zip(one, other, strict=True):
            same(a, b)
    elif isinstance(one, np.ndarray):
        assert one.dtype == other.dtype
        assert one.shape == other.shape
        assert one.tobytes() == other.tobytes()
    else:
        assert one == other


def copies(arguments: tuple[Any, ...]) -> tuple[Any, ...]:
    """Return the arguments with copies of the arrays, which a function may change."""
    return tuple(each.copy() if isinstance(each, np.ndarray) else each for each in arguments)


def in_numpy(function: Callable[..., Any], *arguments: Any) -> Any:
    """Return what a function computes without the compiled loops, with all sums in order."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(native, "built", lambda: None)
        patch.setattr(stop, "_times", product)
        patch.setattr(stop, "_solved", by_cholesky)
        return function(*arguments)


def by_cholesky(squares: Array) -> Array:
    """Return H⁻¹g of [H g], which becomes [U y] with UᵀU = H, by rows and in order."""
    squares, n = squares.copy(), len(squares)
    for j in range(n):
        squares[j, j:] /= np.sqrt(squares[j, j])
        row = squares[j, j + 1 :]
        squares[j + 1 :, j + 1 :] -= row[:-1, None] * row
    p = squares[:, n]
    for i in reversed(range(n)):
        p[i] /= squares[i, i]
        p[:i] -= squares[:i, i] * p[i]
    return p
