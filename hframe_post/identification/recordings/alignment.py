"""The acceleration of a command."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import make_interp_spline

from hframe_post.arrays import TS, Array
from hframe_post.errors import IdentificationError

RESTING = 16  # samples before and after a motion; a spline feels none farther away


def acceleration(position: Array) -> Array:
    """Return the second derivative (m,), mm/s², of positions (m,) in mm every 1 ms.

    It is that of a spline, with a gain within 1e-5 up to 100 Hz; the second difference would be
    2 % low at 80 Hz. Before and after, the position rests where it begins and ends: at the ends of
    its samples alone a spline is free to turn as steeply as it likes. Raises IdentificationError
    for fewer samples than a spline needs.
    """
    degree = 7
    if len(position) <= degree:
        raise IdentificationError(f"a command of {len(position)} ms is too short to be a motion")
    resting = np.pad(position - position[0], RESTING, mode="edge")
    k = np.arange(len(resting), dtype=np.float64)
    spline = make_interp_spline(k, resting, degree)
    return np.asarray(spline.derivative(2)(k[RESTING:-RESTING]) / TS**2)
