"""Tables of numbers as text."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np

from hframe_post.arrays import Array


def read_table(source: Any, **how: Any) -> Array:
    """(rows, columns) as ``numpy.loadtxt`` reads them; no rows are not worth a warning.

    Raises ValueError.
    """
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "loadtxt: input contained no data", UserWarning)
        return np.asarray(np.loadtxt(source, comments=None, ndmin=2, **how))
