"""What a mode prints, and the mode that shows in a print: waves on a wall behind a corner.

Up to the corner one axis brakes from the band's speed to that of the corner, and stops there at
once; the other one goes on along the wall. From then on the first one rings. Its waves are seen as
long as they are higher than some hundredths of a millimetre, which is not known exactly: waves of
hard and soft corners tell it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import find_peaks

from hframe_post.arrays import TS, Array
from hframe_post.errors import IdentificationError
from hframe_post.identification.fitting.discrete import discretize
from hframe_post.model.plant import Filter
from hframe_post.model.transfer_function import TransferFunction

RULER = 0.3  # mm by which a distance may be read wrong
MISCOUNT = 0.6  # waves by which their number may be
DAMPING = np.array([0.02, 0.03, 0.04, 0.05, 0.06, 0.075, 0.09, 0.11, 0.13, 0.16, 0.2])
SEEN_FROM = np.geomspace(0.008, 0.03, 9)  # mm: the lowest wave that is seen
USUAL, SPREAD = 0.016, 0.35  # mm, and standard deviation of its logarithm
PLAUSIBLE_HZ = (8.0, 120.0)


@dataclass(frozen=True, slots=True)
class Band:
    """A part of the wall: its speed and that of its corners, mm/s."""

    speed: float
    corner: float


@dataclass(frozen=True, slots=True)
class Reading:
    """What was read on a band: mm over a number of waves, and how many waves are seen at all."""

    band: Band
    distance: float
    waves: float
    seen: float


@dataclass(frozen=True, slots=True)
class PrintedMode:
    """A mode read from a print.

    uncertainty: standard deviation of its frequency, relative. seen_from: mm, the lowest wave that
    was seen.
    """

    hz: float
    damping: float
    uncertainty: float
    seen_from: float

    def function(self) -> TransferFunction:
        return mode_function(self.hz, self.damping)


def mode_function(hz: float, damping: float) -> TransferFunction:
    """Return a mode that follows its command at rest, for a command of straight lines."""
    w = 2.0 * np.pi * hz * TS
    F = w * np.array([[0.0, 1.0], [-1.0, -2.0 * damping]])
    return discretize([(F, w * np.array([0.0, 1.0]), np.array([1.0, 0.0]))], 0)


def corner_path(band: Band, a: float, side: float) -> tuple[Array, int]:
    """Return the path around a corner, (n, 2) mm every 1 ms, and the sample of the corner.

    It comes along the first axis and leaves along the second. a: mm/s²; side: mm.
    """
    ramp, seconds = (band.speed**2 - band.corner**2) / (2.0 * a), (band.speed - band.corner) / a
    cruise = (side - 2.0 * ramp) / band.speed
    t = np.arange(0.0, 2.0 * seconds + cruise, TS)
    up, down = np.minimum(t, seconds), np.maximum(t - seconds - cruise, 0.0)
    way = band.corner * up + a * up**2 / 2.0 + band.speed * np.maximum(t - seconds, 0.0)
    way -= a * down**2 / 2.0
    rest, n = np.zeros(400), len(way)
    first = np.concatenate([rest, way, np.full(n, side)]) - side
    return np.column_stack([first, np.concatenate([rest, np.zeros(n), way])]), len(rest) + n


def half_waves(deviation: Array) -> Array:
    """Return the heights (k,) of crests and troughs on a wall, in mm."""
    size = np.abs(deviation)
    return np.asarray(size[find_peaks(size)[0]])


def printed_mode(readings: Sequence[Reading], a: float, side: float) -> PrintedMode:
    """Return the mode that readings of one axis show. Raises IdentificationError."""
    measured = [one for one in readings if one.waves > 0.0 and one.distance > 0.0]
    if not measured:
        raise IdentificationError("no band has a distance and a number of waves")
    hz = np.array([one.band.speed * one.waves / one.distance for one in measured])
    weight = np.array(
        [(one.distance / (RULER * f)) ** 2 for one, f in zip(measured, hz, strict=True)]
    )
    mean = float(weight @ hz / weight.sum())
    if not PLAUSIBLE_HZ[0] <= mean <= PLAUSIBLE_HZ[1]:
        low, high = PLAUSIBLE_HZ
        raise IdentificationError(
            f"these waves mean {mean:.0f} Hz, but printers ring at {low:g} to {high:g} Hz: check "
            "the distances in mm and the numbers of waves"
        )
    apart = float(np.sqrt(weight @ (hz - mean) ** 2 / weight.sum())) / mean
    by_ruler = float(weight.sum() ** -0.5) / mean
    damping, seen_from = _fading(readings, mean, a, side)
    natural = mean / math.sqrt(1.0 - damping**2)
    return PrintedMode(natural, damping, max(by_ruler, apart), seen_from)


def _fading(readings: Sequence[Reading], hz: float, a: float, side: float) -> tuple[float, float]:
    """Return the damping and the lowest visible wave that explain how many waves are seen."""
    cost = np.tile((np.log(SEEN_FROM / USUAL) / SPREAD) ** 2, (len(DAMPING), 1))
    for one in readings:
        path, corner = corner_path(one.band, a, side)
        for row, damping in zip(cost, DAMPING.tolist(), strict=True):
            x = Filter(mode_function(hz, damping)).run(path[:, 0] + side) - side
            heights = half_waves(x[corner:])
            seen = (heights > SEEN_FROM[:, None]).sum(axis=1) / 2.0
            row += ((seen - one.seen) / MISCOUNT) ** 2
    likely = np.exp(-0.5 * (cost - cost.min()))
    likely /= likely.sum()
    damping, lowest = likely.sum(axis=1) @ np.log(DAMPING), likely.sum(axis=0) @ np.log(SEEN_FROM)
    return math.exp(damping), math.exp(lowest)
