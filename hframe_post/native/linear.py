"""Linear algebra that gives the same bits on every machine.

BLAS and LAPACK add in an order that depends on the processor. Here every sum starts at zero and
takes its terms in order, one rounding after each product and each addition.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from hframe_post.arrays import Array
from hframe_post.native import compiled


@compiled
def products(a: Array, step: int, m: int, B: Array, /) -> Array:
    """Return m rows (m, n), each of as many numbers of a as B (k, n) has rows, times B.

    The numbers of a row begin ``step`` after those of the row before.
    """


def product(A: Array, B: Array) -> Array:
    """Return the matrix product of A (m, k), or a vector (k,), with B (k, n)."""
    if A.ndim == 1:
        return products(A, 0, 1, B)[0]
    return products(A, A.shape[1], len(A), B)


def windows_product(x: Array, step: int, B: Array) -> Array:
    """Return the products of B (k, n) with the k samples of x from every ``step``-th sample on."""
    return products(x, step, (len(x) - len(B)) // step + 1, B)


@compiled
def recursion(M: Array, W: Array, s: Array, /) -> Array:
    """Return s (d,) and what follows: n numbers at a time, the d before times M (d, n), plus a row.

    W (m, n): these rows. The result has d + m·n numbers.
    """


def pseudo_inverse(A: Array, condition: float) -> Array | None:
    """Return the inverse (n, m) of A (m, n) in the sense of least squares.

    It is None if the condition number of A, in the Frobenius norm, exceeds a limit. A is made
    orthogonal by Gram and Schmidt's method, where each column is projected twice: A = QR.
    """
    m, n = A.shape
    Q, R = np.zeros((m, n)), np.zeros((n, n))
    Qt = np.zeros((n, m))
    for j, v in enumerate(A.T):
        for _ in range(2):
            along = product(v, Q)
            v = v - product(along[:j], Qt[:j])
            R[:, j] += along
        R[j, j] = _norm(v)
        if not R[j, j] > 0.0:
            return None
        Q[:, j] = Qt[j] = v / R[j, j]
    inverse = np.zeros((n, n))
    for i in reversed(range(n)):  # R inverse = I, row by row from the last
        inverse[i] = -product(R[i], inverse)
        inverse[i, i] += 1.0
        inverse[i] /= R[i, i]
    if not _norm(R.ravel()) * _norm(inverse.ravel()) < condition:
        return None
    return product(inverse, Qt)


def _norm(v: Array) -> float:
    return float(np.sqrt(np.cumsum(v * v)[-1]))


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Limit BLAS to one thread in the whole process; also works as a decorator.

    Sums are then taken in one order, so equal inputs give equal bytes. The matrices are too small
    to gain from more threads. The command line sees to it in the environment, before numpy asks:
    entering takes 12 ms.
    """
    if all(os.environ.get(name) == "1" for name in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")):
        yield
        return
    from threadpoolctl import threadpool_limits

    with threadpool_limits(1, user_api="blas"):
        yield
