"""What a mode prints, and the mode that shows in a print: waves on a wall behind a corner.

Up to the corner one axis brakes from the band's speed to that of the corner, and stops there at
once; the other one goes on along the wall. From then on the first one rings. Its waves are seen as
long as they are higher than some hundredths of a millimetre, which is not known exactly: waves of
hard and soft corners tell it.

A mode with the poles s₁ and s̄₁ responds to a command U with G·U, G = |s₁|²/((s − s₁)(s − s̄₁)). Of a
command of straight lines, s²U is pulses at the samples, so an ``ImpulseResponse`` is exact. Its
deviation is the inverse Laplace transform of G/s², without the double pole at rest, which is the
command and its lag of 2ζ/ω.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import find_peaks

from hframe_post.arrays import TS, Array
from hframe_post.errors import IdentificationError
from hframe_post.model.filters import FiniteFilter
from hframe_post.model.impulse_response import ImpulseResponse

RULER = 0.3  # mm by which a distance may be read wrong
MISCOUNT = 0.6  # waves by which their number may be
DAMPING = np.array([0.02, 0.03, 0.04, 0.05, 0.06, 0.075, 0.09, 0.11, 0.13, 0.16, 0.2])
SEEN_FROM = np.geomspace(0.008, 0.03, 9)  # mm: the lowest wave that is seen
USUAL, SPREAD = 0.016, 0.35  # mm, and standard deviation of its logarithm
PLAUSIBLE_HZ = (8.0, 120.0)
# waves behind a corner where a reading begins: the form says the second crest, and the first one is
# a quarter of a wave behind the corner, since the axis stops at once
SECOND_CREST = 1.25
FREQUENCIES, HALVINGS = (1.0, 2000.0), 40  # Hz within which a reading's is sought
CANDIDATES = 400


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

    def response(self) -> ImpulseResponse:
        return ImpulseResponse.from_mode(self.hz, self.damping)


def travel(length: float, speed: float, ends: float, up: float, down: float) -> Array:
    """Return the way (n,) in mm every 1 ms along a line that begins and ends at mm/s.

    up, down: mm/s² from there to the speed, and back.
    """
    gained, lost = (speed - ends) / up, (speed - ends) / down
    cruise = (length - (speed + ends) / 2.0 * (gained + lost)) / speed
    t = np.arange(round((gained + cruise + lost) / TS)) * TS
    braked = np.maximum(t - gained - cruise, 0.0)
    way = ends * t + (speed - ends) * np.maximum(t - gained, 0.0)
    return np.asarray(way + up * np.minimum(t, gained) ** 2 / 2.0 - down * braked**2 / 2.0)


def corner_path(band: Band, a: float, side: float) -> tuple[Array, int]:
    """Return the path around a corner, (n, 2) mm every 1 ms, and the sample of the corner.

    It comes along the first axis and leaves along the second. a: mm/s²; side: mm.
    """
    way = travel(side, band.speed, band.corner, a, a)
    still = np.zeros(len(way))
    first, second = np.concatenate([way - side, still]), np.concatenate([still, way])
    return np.column_stack([first, second]), len(way)


def printed_mode(readings: Sequence[Reading], a: float, side: float) -> PrintedMode:
    """Return the mode that readings of one axis show. Raises IdentificationError.

    A reading that differs from the others, such as one with a wave too many, hardly counts.
    """
    measured = [one for one in readings if one.waves > 0.0]
    if not measured:
        raise IdentificationError("no band has a distance and a number of waves")
    hz = np.array([frequency(one, a, side) for one in measured])
    steps = np.diff([[frequency(replace(one, distance=one.distance + sign * RULER), a, side)
                      for sign in (-1.0, 1.0)] for one in measured])  # fmt: skip
    by_ruler = np.abs(steps[:, 0]) / (2.0 * hz)  # relative, of each
    mean = _agreed(hz, by_ruler)
    low, high = PLAUSIBLE_HZ
    if not low <= mean <= high:
        raise IdentificationError(
            f"these waves mean {mean:.0f} Hz, but printers ring at {low:g} to {high:g} Hz: check "
            "that each distance is in mm and over all of the waves that you counted, not over one"
        )
    weight = by_ruler**-2.0
    apart = math.sqrt(weight @ np.log(hz / mean) ** 2 / weight.sum())
    damping, seen_from = _fading(readings, mean, a, side)
    natural = mean / math.sqrt(1.0 - damping**2)
    uncertainty = max(float(weight.sum() ** -0.5), apart)
    return PrintedMode(natural, damping, uncertainty, seen_from)


def frequency(one: Reading, a: float, side: float) -> float:
    """Return the frequency, Hz, at which waves are as far apart as they were read.

    They are closer together where the head is still gaining speed: in the ramp behind the corner.
    """
    path, corner = corner_path(one.band, a, side)
    along, t = path[corner:, 1], np.arange(len(path) - corner) * TS
    low, high = FREQUENCIES
    for _ in range(HALVINGS):
        hz = math.sqrt(low * high)
        crests = (SECOND_CREST + np.array([0.0, one.waves])) / hz
        near, far = np.interp(crests, t, along, right=2.0 * side).tolist()
        low, high = (hz, high) if far - near > one.distance else (low, hz)
    return math.sqrt(low * high)


def _agreed(hz: Array, off: Array) -> float:
    """Return the frequency that most of some (k,) agree on; off (k,): their relative errors."""
    candidates = np.geomspace(hz.min(), hz.max(), CANDIDATES)
    apart = np.log(hz / candidates[:, None]) / off
    return float(candidates[np.argmin(np.log1p(apart**2).sum(axis=1))])


def _fading(readings: Sequence[Reading], hz: float, a: float, side: float) -> tuple[float, float]:
    """Return the damping and the lowest visible wave that explain how many waves are seen."""
    cost = np.tile((np.log(SEEN_FROM / USUAL) / SPREAD) ** 2, (len(DAMPING), 1))
    for one in readings:
        path, corner = corner_path(one.band, a, side)
        for row, damping in zip(cost, DAMPING.tolist(), strict=True):
            x = (
                FiniteFilter(ImpulseResponse.from_mode(hz, damping), 0).run(path[:, 0] + side)
                - side
            )
            heights, _ = half_waves(x[corner:])
            seen = (heights > SEEN_FROM[:, None]).sum(axis=1) / 2.0
            row += ((seen - one.seen) / MISCOUNT) ** 2
    likely = likelihood(cost)
    damping, lowest = likely.sum(axis=1) @ np.log(DAMPING), likely.sum(axis=0) @ np.log(SEEN_FROM)
    return math.exp(damping), math.exp(lowest)


def half_waves(across: Array) -> tuple[Array, Array]:
    """Return heights (k,) in mm and samples (k,) of the crests and troughs on a wall."""
    size = np.abs(across)
    found = find_peaks(size)[0]
    return size[found], found


def likelihood(cost: Array) -> Array:
    """Return how likely each of several explanations is, from sums of squared differences."""
    likely = np.exp(-0.5 * (cost - cost.min()))
    return np.asarray(likely / likely.sum())
