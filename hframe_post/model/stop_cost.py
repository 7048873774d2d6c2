"""What is judged beside a stop: the nozzle against the path, where filament is laid most of all.

Symbols and weights are those of ``model.stop``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hframe_post.arrays import Array, Flags, Integers, X, Y

BESIDE = 100  # samples before and after a stop in which its command may change
BEYOND = 100  # samples after these that are still judged: what rings, shows there
EACH, SECOND = 24, 60  # samples from a stop up to which each is judged, every second; then each 4th
NEAREST = 24  # samples to either side in which the path's nearest point is sought
TRAVELLING = 0.03  # weight of a sample that does not extrude; of one that does: 1
STANDING = 0.04  # weight of a sample of the hold, of which every STRIDE-th counts
ARRIVING = 1.0  # weight of the hold's last sample where an extrusion begins there
ALONG = 0.01  # weight of a deviation along the path; of one across: 1
FAR = 0.05  # mm off the path, from which on a sample that extrudes weighs more
EMPHASIS, MOST_EMPHASIS = 1.5, 10.0  # times, for one that is FAR, growing with the square; at most
SOON = 25  # samples after a hold in which an extrusion begins there

STRIDE, SWING = 4, 64  # samples between those of a hold, and how far into it


def _spread(n: int) -> tuple[Integers, Array]:
    """Which of n samples on one side of a stop are judged, nearest first; for how many each."""
    near, middle = np.arange(EACH), np.arange(EACH, SECOND, 2)
    far = np.arange(SECOND, n, 4)
    counted = np.repeat([1.0, 2.0, 4.0], [len(near), len(middle), len(far)])
    return np.concatenate([near, middle, far]), counted


BEFORE, FOR_BEFORE = (of[::-1] for of in _spread(BESIDE))
BEFORE = BESIDE - 1 - BEFORE  # of the samples from a − BESIDE on
AFTER, FOR_AFTER = _spread(BESIDE + BEYOND)  # of those from b on


@dataclass(frozen=True, slots=True)
class Stop:
    """A stop in a stretch of samples: the command stands from sample a to b − 1.

    before, after: samples on either side that may change; held: whether the place of the hold
    may. ends: the first sample after b that counts no more, since another stop begins there.
    """

    a: int
    b: int
    before: int
    after: int
    held: bool
    ends: int

    def shifted(self, n: int) -> Stop:
        """Return the stop with its samples counted from n samples earlier."""
        return replace(self, a=self.a + n, b=self.b + n, ends=self.ends + n)


@dataclass(frozen=True, slots=True)
class Surroundings:
    """n samples of a stretch: path (n, 2) from its origin (2,), mm; extruding (n,)."""

    path: Array
    origin: Array
    extruding: Flags


@dataclass(frozen=True, slots=True)
class Nozzle:
    """x and y of the nozzle: free (r, 2), and by p, whose halves are those of x and y.

    x, y (r, k): by their own halves; across (r, k): y by that of x, where the gantry racks.
    """

    free: Array
    x: Array
    across: Array
    y: Array

    @classmethod
    def of(cls, outputs: list[tuple[Array, Array]], lever: Array) -> Nozzle:
        """From the filters' outputs: eq. 1 and 2 of the paper with the lever arm of the path."""
        (x, free_x), (y, free_y), *racking = outputs
        across = np.zeros_like(x)
        for theta, free in racking:
            across, free_y = lever[:, None] * theta, free_y + lever * free
        return cls(np.column_stack([free_x, free_y]), x, across, y)

    def at(self, p: Array) -> Array:
        """Places (r, 2)."""
        of_x, of_y = p.reshape(2, -1)
        moved = np.column_stack([self.x @ of_x, self.across @ of_x + self.y @ of_y])
        return np.asarray(self.free + moved)

    def normal_equations(self, rows: Rows, foot: Array, t: Array) -> tuple[Array, Array]:
        """H and g of ½pᵀHp + gᵀp, with the feet and directions (m, 2) that were found."""
        m, k = len(rows.path), self.x.shape[1]
        at = self.free
        normal = np.sqrt(rows.weight)
        along = np.sqrt(ALONG) * normal
        x, across, y = self.x[:m], self.across[:m], self.y[:m]
        J, r = np.empty((2 * m, 2 * k)), np.empty(2 * m)
        for half, nx, ny in (
            (slice(0, m), -normal * t[:, Y], normal * t[:, X]),
            (slice(m, None), along * t[:, X], along * t[:, Y]),
        ):
            J[half, :k] = nx[:, None] * x + ny[:, None] * across
            J[half, k:] = ny[:, None] * y
            off = at[:m] - (rows.path if half.start else foot)
            r[half] = nx * off[:, X] + ny * off[:, Y]
        H, g = J.T @ J, J.T @ r
        held_y = np.hstack([self.across[m:], self.y[m:]])
        for own, of_p, place, hold in (
            (slice(0, k), self.x[m:], at[m:, X], rows.hold[X]),
            (slice(None), held_y, at[m:, Y], rows.hold[Y]),
        ):
            weighted = rows.holding[:, None] * of_p
            H[own, own] += weighted.T @ of_p
            g[own] += weighted.T @ (place - hold)
        return H, g


@dataclass(frozen=True, slots=True)
class Rows:
    """What is judged: path, direction (m, 2), weight (m,) of samples around the hold.

    laid (m,): where filament is; candidates (m, 2·NEAREST + 1, 2): the path around each; hold
    (2,): where the path stands; holding: weights of the rows in the hold.
    """

    path: Array
    direction: Array
    weight: Array
    laid: Flags
    candidates: Array
    hold: Array
    holding: Array

    @classmethod
    def of(cls, around: Surroundings, stop: Stop) -> Rows:
        """Of that stop."""
        a, b = stop.a, stop.b
        index = sampled(stop)
        counted = np.concatenate([FOR_BEFORE, FOR_AFTER if stop.after else 0.0 * FOR_AFTER])
        weight = np.where(around.extruding[index], counted, TRAVELLING * counted)
        weight[(index >= stop.ends) | (index < a - stop.before)] = 0.0
        near = index[:, None] + np.arange(-NEAREST, NEAREST + 1)
        candidates = around.path[near]
        ahead = candidates[:, NEAREST + 1] - candidates[:, NEAREST]
        holding = np.full(len(judged(b - a)), STANDING)
        if around.extruding[b : b + SOON].any():
            holding[-1:] = ARRIVING
        return cls(
            around.path[index], _unit(ahead, np.array([1.0, 0.0])), weight,
            around.extruding[index] & (weight > 0.0), candidates, around.path[a], holding,
        )  # fmt: skip

    def off(self, at: Array) -> Array:
        """How far the nozzle's places are from the path, (m,), mm; 0 where no filament is laid."""
        foot, _ = self.nearest(at)
        off = at[: len(foot)] - foot
        return np.where(self.laid, np.hypot(off[:, X], off[:, Y]), 0.0)

    def emphasised(self, off: Array) -> Rows:
        """The same with more weight where the nozzle is FAR ``off`` (m,)."""
        more = np.minimum(EMPHASIS * np.square(off / FAR), MOST_EMPHASIS)
        return replace(self, weight=self.weight * np.where(off > FAR, more, 1.0))

    def nearest(self, at: Array) -> tuple[Array, Array]:
        """The path's nearest points to the nozzle's places, and its directions there, (m, 2)."""
        x, y = self.candidates[..., X], self.candidates[..., Y]
        dx, dy = np.diff(x), np.diff(y)
        place = at[: len(self.path)]
        to_x, to_y = place[:, X, None] - x[:, :-1], place[:, Y, None] - y[:, :-1]
        along = (to_x * dx + to_y * dy) / np.maximum(dx * dx + dy * dy, 1e-18)
        along = np.clip(along, 0.0, 1.0)
        off_x, off_y = to_x - along * dx, to_y - along * dy
        best = (off_x * off_x + off_y * off_y).argmin(axis=1)
        row = np.arange(len(best))
        foot = place - np.column_stack([off_x[row, best], off_y[row, best]])
        step = np.column_stack([dx[row, best], dy[row, best]])
        return foot, _unit(step, self.direction)


def sampled(stop: Stop) -> Integers:
    """Which samples of a stretch are judged around its hold."""
    return np.concatenate([stop.a - BESIDE + BEFORE, stop.b + AFTER])


def _unit(vector: Array, otherwise: Array) -> Array:
    """Directions (m, 2); where there is none, another's."""
    length = np.hypot(vector[:, X], vector[:, Y])[:, None]
    return np.asarray(np.where(length > 1e-7, vector / np.maximum(length, 1e-7), otherwise))


def judged(n: int) -> list[int]:
    """Samples of a hold of n that count: how far the nozzle swings, and where it is at last."""
    return [*range(STRIDE - 1, min(n, SWING) - 1, STRIDE), n - 1] if n else []
