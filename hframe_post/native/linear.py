"""Linear algebra that gives the same bits on every machine.

BLAS and LAPACK add in an order that depends on the processor. Here every sum starts at zero and
takes its terms in order, one rounding after each product and each addition.
"""

from __future__ import annotations

import numpy as np

from hframe_post.arrays import Array
from hframe_post.native import kernels


def product(A: Array, B: Array) -> Array:
    """Return the matrix product of A (m, k), or a vector (k,), with B (k, n)."""
    rows = np.ascontiguousarray(np.atleast_2d(A))
    out = _by_rows(rows, rows.shape[1], len(rows), B)
    return out if A.ndim == 2 else out[0]


def windows_product(x: Array, step: int, B: Array) -> Array:
    """Return the products of B (k, n) with the k samples of x from every ``step``-th sample on."""
    return _by_rows(x, step, (len(x) - len(B)) // step + 1, B)


def _by_rows(x: Array, step: int, m: int, B: Array) -> Array:
    (k, n), B = B.shape, np.ascontiguousarray(B)  # else numpy adds pairs of a column's terms
    out = np.empty((m, n))
    kernels.product(x, step, B, m, k, n, out)
    return out


def recursion(A: Array, W: Array, s: Array) -> Array:
    """Return s (d,) and what follows: n numbers at a time, A (n, d) times the d before, plus a row.

    W (m, n): these rows. The result has d + m·n numbers.
    """
    M, W, d = np.ascontiguousarray(A.T), np.ascontiguousarray(W), len(s)
    following = np.empty(d + W.size)
    following[:d] = s
    kernels.recursion(M, W, len(W), d, len(A), following)
    return following


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
