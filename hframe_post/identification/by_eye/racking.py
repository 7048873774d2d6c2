"""Racking that shows in print: a wall along x in blocks, each travelled from rest to rest.

At a border the head brakes and sets out again, so the gantry turns to and fro, and the nozzle
draws waves across the wall: the larger, the farther it is from the place x_c, where there are none.

    y = (x − x_c)·θ        θ″ = ω²(κx″ − θ) − 2ζωθ′
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise, product

import numpy as np
from scipy.signal import find_peaks

from hframe_post.arrays import TS, Array
from hframe_post.identification.by_eye.waves import MISCOUNT, RULER, PrintedMode
from hframe_post.identification.fitting.discrete import discretize
from hframe_post.model.plant import Filter
from hframe_post.model.transfer_function import TransferFunction

BLOCK, SOFTER = 20.0, 2.5  # mm of a block; factor between the two accelerations
LEVER = 5.0  # mm behind a block's border at which its waves are seen
MODES = list(product(np.geomspace(25.0, 110.0, 28).tolist(), (0.03, 0.05, 0.08, 0.12, 0.18)))
GAINS = np.geomspace(1e-9, 1e-6, 61)  # κ, rad per mm/s²
OFF_CENTRE = np.arange(-40.0, 41.0, 4.0)  # mm of x_c from the middle of the travel
USUALLY_OFF = 15.0  # mm, standard deviation of that
CLEAR = 1.5  # waves that the block with most of them must show
UNLIKELY = 9.0  # squared difference if there are not even as many waves
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

    def ramps(self) -> Array:
        """Return the mm that reaching the speed takes at each border, (blocks + 1,)."""
        return self.speed**2 / (2.0 * np.array(self.accelerations))

    def path(self) -> tuple[Array, list[int]]:
        """Return x (n,) in mm every 1 ms, and the samples at which the blocks begin and end."""
        v, pieces, ends = self.speed, list[Array](), [0]
        for start, (a, b) in zip(self.borders(), pairwise(self.accelerations), strict=True):
            cruise = (BLOCK - v**2 / (2.0 * a) - v**2 / (2.0 * b)) / v
            t = np.arange(round((v / a + cruise + v / b) / TS)) * TS
            up, down = np.minimum(t, v / a), np.maximum(t - v / a - cruise, 0.0)
            way = a * up**2 / 2.0 + v * np.maximum(t - v / a, 0.0) - b * down**2 / 2.0
            pieces.append(start + way)
            ends.append(ends[-1] + len(t))
        return np.concatenate(pieces), ends


@dataclass(frozen=True, slots=True)
class Blocks:
    """What was read: how many waves each block shows but the first, and on the block ``of`` (from
    0) mm over a number of waves."""

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

    def function(self, x: PrintedMode) -> TransferFunction:
        """Return θ per mm of the command in x, whose mode is given."""
        return racking_function(x, self.gain, self.hz, self.damping)


def racking_function(x: PrintedMode, gain: float, hz: float, damping: float) -> TransferFunction:
    """Return the gantry's angle per mm of a command of straight lines."""
    w, v = 2.0 * np.pi * x.hz * TS, 2.0 * np.pi * hz * TS
    drive = gain * w / TS**2  # θ′/v follows v·drive·(w·u − …)
    F = np.array([
        [0.0, w, 0.0, 0.0], [-w, -2.0 * x.damping * w, 0.0, 0.0],
        [0.0, 0.0, 0.0, v],
        [-v * drive * w, -2.0 * x.damping * v * drive * w, -v, -2.0 * damping * v],
    ])  # fmt: skip
    g = np.array([0.0, w, 0.0, v * drive * w])
    return discretize([(F, g, np.array([0.0, 0.0, 1.0, 0.0]))], 2)


def printed_racking(
    read: Blocks, comb: Comb, x: PrintedMode, middle: float, seen_from: float
) -> PrintedRacking | None:
    """Return the racking that explains what was read; None if that is too little to tell.

    middle: of the travel in x, mm. seen_from: mm, the lowest wave that this owner sees.
    """
    if max(read.seen) < CLEAR or x.uncertainty > VAGUE:
        return None
    centres = middle + OFF_CENTRE
    levers = np.abs(comb.borders()[1:, None] + LEVER - centres)  # (blocks, centres)
    costs, answers = [], []
    path, _ = comb.path()
    for hz, damping in MODES:
        theta = Filter(racking_function(x, 1.0, hz, damping)).run(path - path[0])
        cost = np.zeros((len(GAINS), len(centres)))
        for block, (heights, places) in enumerate(half_waves_by_block(comb, theta)):
            if block:
                lowest = seen_from / np.outer(GAINS, heights)  # lever from which a wave is seen
                seen = (levers[block - 1][:, None] > lowest[:, None]).sum(axis=2) / 2.0
                cost += ((seen - read.seen[block - 1]) / MISCOUNT) ** 2
            if block == read.of:
                cost += _spacing(places, read)
        costs.append(cost)
        answers.append(theta)
    cost = np.array(costs) + (OFF_CENTRE / USUALLY_OFF) ** 2
    likely = np.exp(-0.5 * (cost - cost.min()))
    likely /= likely.sum()
    x_c = float(likely.sum(axis=(0, 1)) @ centres)
    found = _mean(likely.sum(axis=2), np.array(answers), x_c)
    clear = found.uncertainty < UNKNOWN and cost.min() < INCONSISTENT * len(read.seen)
    return found if clear else None


def half_waves_by_block(comb: Comb, across: Array) -> Iterator[tuple[Array, Array]]:
    """Yield heights (k,) and places (k,), in mm from the border, of the half waves of a block.

    across (n,): what the nozzle draws on the path of the comb, or is as long.
    """
    path, ends = comb.path()
    ramps = comb.ramps()
    for k, (start, first, last) in enumerate(zip(comb.borders(), ends, ends[1:], strict=False)):
        along, size = path[first:last] - start, np.abs(across[first:last])
        found = find_peaks(size)[0]
        found = found[(along[found] > ramps[k]) & (along[found] < BLOCK - ramps[k + 1])]
        yield size[found], along[found]


def _spacing(places: Array, read: Blocks) -> float:
    """Return the squared difference between half waves (k,) and the distance that was read."""
    last = round(2.0 * read.waves)
    if not last or not read.distance:
        return 0.0
    if last >= len(places):
        return UNLIKELY
    return float((places[last] - places[0] - read.distance) / (2.0 * RULER)) ** 2


def _mean(likely: Array, answers: Array, x_c: float) -> PrintedRacking:
    """Return the racking that is nearest to the mean of all, by their angles on the comb.

    likely: by mode and κ. answers: θ for a κ of 1, by mode, every 1 ms.
    """
    mean = (likely @ GAINS) @ answers
    power = (answers**2).sum(axis=1)
    gains = np.maximum(answers @ mean / power, GAINS[0])
    best = int(np.argmin(((gains[:, None] * answers - mean) ** 2).sum(axis=1)))
    expected = float((likely @ GAINS**2) @ power)
    apart = np.sqrt(max(1.0 - float(mean @ mean) / expected, 0.0))
    return PrintedRacking(float(gains[best]), *MODES[best], x_c, float(apart))
