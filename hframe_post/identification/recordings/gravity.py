"""Gravity as a witness of a sensor's gains: what it shows at rest, turned several ways.

Of each axis i a sensor shows r_i = g_i·a_i + b_i, and at rest |a| is gravity, however it lies:

    Σ ((r_i − b_i) / g_i)² = G²
"""

from __future__ import annotations

import numpy as np
from scipy import optimize

from hframe_post.arrays import Array
from hframe_post.errors import IdentificationError
from hframe_post.identification.recordings.accelerometer import AXES, GRAVITY, axis_map

FEWEST = 6  # readings: each axis up and down
TURNED = 1.6  # times gravity, between the extremes of an axis
CERTAIN = 0.005  # of a gain, relative: a reading is one sample, of noise and whole steps
MOST_OFF = 0.15  # of a gain, that a sensor may have


def gains(readings: Array) -> Array:
    """What the sensor shows of 1 mm/s² along each of its axes, (3,); readings (n, 3): mm/s².

    Raises IdentificationError where the readings do not tell it.
    """
    spans = np.ptp(readings, axis=0)
    if len(readings) < FEWEST or (spans < TURNED * GRAVITY).any():
        which = AXES[int(np.argmin(spans))]
        raise IdentificationError(
            f"{len(readings)} readings at rest do not tell the sensor's gains: turn it so that "
            f"each of its axes points up once and down once; {which} spans {spans.min():.0f} "
            f"mm/s², not about {2.0 * GRAVITY:.0f}"
        )
    middle = (readings.max(axis=0) + readings.min(axis=0)) / 2.0
    start = np.concatenate([spans / (2.0 * GRAVITY), middle / GRAVITY])

    def off(x: Array) -> Array:
        a = (readings / GRAVITY - x[3:]) / x[:3]
        return np.asarray((a * a).sum(axis=1) - 1.0)

    found = np.asarray(optimize.least_squares(off, start).x[:3])
    if (np.abs(found - 1.0) > MOST_OFF).any():
        raise IdentificationError(
            "by its readings at rest the sensor is more than 15 % off: was it still, and is the "
            "unit mm/s²?"
        )
    return found


def along_printer(found: Array, axes: str) -> tuple[float, float]:
    """The gains along the printer's x and y, of those of the sensor's axes (3,)."""
    x, y, _ = np.abs(axis_map(axes)) @ found
    return float(x), float(y)
