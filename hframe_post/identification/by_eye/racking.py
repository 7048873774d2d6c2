"""Racking that shows in print: a wall along x in blocks, each travelled from rest to rest.

At a border the head brakes and sets out again, so the gantry turns to and fro, and the nozzle
draws waves across the wall: the larger, the farther it is from the place x_c, where there are none.

    y = (x − x_c)·θ        θ″ = ω²(κx″ − θ) − 2ζωθ′
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import accumulate, pairwise, product

import numpy as np

from hframe_post.arrays import TS, Array
from hframe_post.identification.by_eye.waves import (
    MISCOUNT,
    RULER,
    PrintedMode,
    half_waves,
    likelihood,
    pole,
    ringing,
    travel,
)
from hframe_post.model.filters import FiniteFilter
from hframe_post.model.impulse_response import ImpulseResponse

BLOCK, SOFTER = 20.0, 2.5  # mm of a block; factor between the two accelerations
LEVER = 5.0  # mm behind a block's border at which its waves are seen
MODES = list(product(np.geomspace(25.0, 110.0, 28).tolist(), (0.03, 0.05, 0.08, 0.12, 0.18)))
GAINS = np.geomspace(1e-9, 1e-6, 61)  # κ, rad per mm/s²
OFF_CENTRE = np.arange(-40.0, 41.0, 4.0)  # mm of x_c from the middle of the travel
USUALLY_OFF = 15.0  # mm, standard deviation of that
# beyond these, racking that was read is wrong as often as right: uncertainty of the frequency of x,
# share of racking that would stay, and squared difference of the counts by block
VAGUE, UNKNOWN, INCONSISTENT = 0.25, 0.7, 1.5


@dataclass(frozen=True, slots=True)
class Comb:
    """A wall from x = left (mm) to the right in a number of blocks, at mm/s and mm/s².

    The acceleration at every second border is lower, which distinguishes the gantry's own mode
    from that of x.
    """

    left: float
    blocks: int
    speed: float
    acceleration: float

    @property
    def accelerations(self) -> list[float]:
        """Return mm/s² at the borders, both before and behind, (blocks + 1,)."""
        return [self.acceleration / (1.0, SOFTER)[k % 2] for k in range(self.blocks + 1)]

    def borders(self) -> Array:
        """Return where the blocks begin, (blocks,) mm."""
        return np.asarray(self.left + BLOCK * np.arange(self.blocks))

    def path(self) -> tuple[Array, list[int]]:
        """Return x (n,) in mm every 1 ms, and the samples at which the blocks begin and end."""
        ways = [travel(BLOCK, self.speed, 0.0, *both) for both in pairwise(self.accelerations)]
        pieces = [start + way for start, way in zip(self.borders(), ways, strict=True)]
        return np.concatenate(pieces), [0, *accumulate(map(len, pieces))]


@dataclass(frozen=True, slots=True)
class CombReading:
    """What was read of a comb: how many waves each block shows but the first, and on the block
    ``of`` (from 0) mm over a number of waves."""

    comb: Comb
    seen: tuple[float, ...]
    of: int
    distance: float
    waves: float


@dataclass(frozen=True, slots=True)
class PrintedRacking:
    """Racking read from a print: κ in rad per mm/s², its mode, and x_c in mm.

    uncertainty: share of the racking, RMS, that is expected to stay.
    """

    gain: float
    hz: float
    damping: float
    x_c: float
    uncertainty: float

    def response(self, x: PrintedMode) -> ImpulseResponse:
        """Return θ per mm of the command in x, whose mode is given."""
        theta = ringing([pole(x.hz, x.damping), pole(self.hz, self.damping)], 0)
        return ImpulseResponse(self.gain / TS**2 * theta, 0, rest=0.0)


def printed_racking(
    read: CombReading, x: PrintedMode, middle: float, seen_from: float
) -> PrintedRacking | None:
    """Return the racking that explains what was read; None if that is too little to tell.

    middle: of the travel in x, mm. seen_from: mm, the lowest wave that this owner sees.
    """
    if x.uncertainty > VAGUE:
        return None
    centres = middle + OFF_CENTRE
    levers = np.abs(read.comb.borders()[1:, None] + LEVER - centres)  # (blocks, centres)
    path, _ = read.comb.path()
    unscaled = [PrintedRacking(1.0, *mode, middle, 0.0) for mode in MODES]
    responses = [FiniteFilter(one.response(x), 0).run(path - path[0]) for one in unscaled]
    cost = np.tile((OFF_CENTRE / USUALLY_OFF) ** 2, (len(MODES), len(GAINS), 1))
    for of_mode, theta in zip(cost, responses, strict=True):
        blocks = list(half_waves_by_block(read.comb, theta))
        for lever, seen, (heights, _) in zip(levers, read.seen, blocks[1:], strict=True):
            lowest = seen_from / np.outer(GAINS, heights)  # lever from which a wave is seen
            counted = (lever[:, None] > lowest[:, None]).sum(axis=2) / 2.0
            of_mode += ((counted - seen) / MISCOUNT) ** 2
        of_mode += _spacing(blocks[read.of][1], read)
    likely = likelihood(cost)
    x_c = float(likely.sum(axis=(0, 1)) @ centres)
    found = _mean(likely.sum(axis=2), np.array(responses), x_c)
    clear = found.uncertainty < UNKNOWN and cost.min() < INCONSISTENT * len(read.seen)
    return found if clear else None


def half_waves_by_block(comb: Comb, across: Array) -> Iterator[tuple[Array, Array]]:
    """Yield heights (k,) and places (k,), in mm from the border, of the half waves of a block.

    across (n,): what the nozzle draws on the path of the comb, or is as long. Only waves where the
    head has its full speed count.
    """
    path, ends = comb.path()
    ramps = comb.speed**2 / (2.0 * np.array(comb.accelerations))
    for start, (first, last), (up, down) in zip(
        comb.borders(), pairwise(ends), pairwise(ramps), strict=True
    ):
        heights, found = half_waves(across[first:last])
        along = path[first:last][found] - start
        steady = (along > up) & (along < BLOCK - down)
        yield heights[steady], along[steady]


def _spacing(places: Array, read: CombReading) -> float:
    """Return the squared difference between half waves (k,) and the distance that was read."""
    last = round(2.0 * read.waves)
    if not last or not read.distance:
        return 0.0
    if last >= len(places):
        return ((last + 1 - len(places)) / (2.0 * MISCOUNT)) ** 2
    return float((places[last] - places[0] - read.distance) / (2.0 * RULER)) ** 2


def _mean(likely: Array, responses: Array, x_c: float) -> PrintedRacking:
    """Return the racking that is nearest to the mean of all, by their angles on the comb.

    likely: by mode and κ. responses: θ for a κ of 1, by mode, every 1 ms.
    """
    mean = (likely @ GAINS) @ responses
    power = (responses**2).sum(axis=1)
    gains = np.maximum(responses @ mean / power, GAINS[0])
    best = int(np.argmin(((gains[:, None] * responses - mean) ** 2).sum(axis=1)))
    expected = float((likely @ GAINS**2) @ power)
    apart = np.sqrt(max(1.0 - float(mean @ mean) / expected, 0.0))
    return PrintedRacking(float(gains[best]), *MODES[best], x_c, float(apart))
