"""The range of an error: what becomes of its RMS as the printer changes.

==========  ==========================================================================  ======
symbol      meaning                                                                     unit
==========  ==========================================================================  ======
``e``       error of the model's nozzle at a sample                                     mm
``d``       what one standard deviation of the drift of x's and y's frequencies adds    mm
``u²``      expected square of what the unknown part of the responses adds              mm²
``z``       drifts of x and y, standard normal, the same for a whole print              —
==========  ==========================================================================  ======

The command is fixed, so the nozzle is linear in what is not known of the printer, and the mean
square error of a print is a quadratic form, e² + 2 e·d z + (d z)² + u², of a few sums over its
samples. Its quantiles follow from a fixed set of equally likely printers.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from statistics import NormalDist

import numpy as np

from hframe_post.arrays import Array

DRAWS = 15  # values of the drift of each axis, and of the size of the unknown part
SUMS = 8  # of 1, e², e·d_x, e·d_y, d_x², d_x·d_y, d_y², u²


@dataclass(frozen=True, slots=True)
class ErrorRange:
    """RMS error in mm: the median over what is not known of the printer, and its 90 % range."""

    median: float
    low: float
    high: float


def products(e: Array, d: Array, unknown: Array) -> Array:
    """Return the terms of samples, (n, SUMS), whose sums ``error_range`` takes.

    e (n,), d (n, 2), unknown (n,): u².
    """
    x, y = d.T
    terms = np.array([np.ones(len(e)), e * e, e * x, e * y, x * x, x * y, y * y, unknown])
    return terms.T


def error_range(sums: Array, mean_square: float) -> ErrorRange:
    """Return the range of an RMS error from sums of ``products``, of at least one sample.

    mean_square: of e over all samples, which may be more than those that were summed up, mm².
    """
    x, y, size = _draws()
    _, _, ex, ey, xx, xy, yy, unknown = (sums / sums[0]).tolist()
    drifted = 2.0 * (ex * x + ey * y) + xx * x * x + 2.0 * xy * x * y + yy * y * y
    squares = np.sort(np.maximum(mean_square + drifted, 0.0) + unknown * size)
    at = (np.array([0.5, 0.05, 0.95]) * len(squares)).astype(int)
    return ErrorRange(*np.sqrt(squares[at]).tolist())


@cache
def _draws() -> tuple[Array, Array, Array]:
    """Return equally likely drifts of x and of y, and shares of u² (chi-squared), (DRAWS³,) each.

    The chi-squared quantiles are those of Wilson and Hilferty (1931).
    """
    normal = NormalDist()
    z = np.array([normal.inv_cdf((k + 0.5) / DRAWS) for k in range(DRAWS)])
    freedoms = 3  # of the unknown part: as few, because its size is not well known, either
    spread = 2.0 / (9.0 * freedoms)
    size = np.maximum(1.0 - spread + z * np.sqrt(spread), 0.0) ** 3
    x, y, size = (each.ravel() for each in np.meshgrid(z, z, size / size.mean()))
    return x, y, size
