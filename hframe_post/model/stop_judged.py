"""What is judged beside a stop: the nozzle against the path, where filament is laid most of all.

Symbols and weights are those of ``model.stop``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hframe_post.arrays import Array, Flags, X, Y
from hframe_post.model.stop_filters import judged

BESIDE = 100  # samples before and after a stop in which its command may change
BEYOND = 100  # samples after these that are still judged: what rings, shows there
NEAREST = 24  # samples to either side in which the path's nearest point is sought
TRAVELLING = 0.03  # weight of a sample that does not extrude; of one that does: 1
STANDING = 0.04  # weight of a sample of the hold, of which every STRIDE-th counts
ARRIVING = 1.0  # weight of the hold's last sample where an extrusion begins there
ALONG = 0.01  # weight of a deviation along the path; of one across: 1
SOON = 25  # samples after a hold in which an extrusion begins there


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


@dataclass(frozen=True, slots=True)
class Surroundings:
    """n samples of a stretch: path (n, 2) from its origin (2,), mm; extruding (n,)."""

    path: Array
    origin: Array
    extruding: Flags


@dataclass(frozen=True, slots=True)
class Nozzle:
    """x and y of the nozzle: free (r, 2), and by p (r, 2k) each."""

    free: Array
    x: Array
    y: Array

    @classmethod
    def of(cls, outputs: list[tuple[Array, Array]], lever: Array) -> Nozzle:
        """From the filters' outputs: eq. 1 and 2 of the paper with the lever arm of the path."""
        (x, free_x), (y, free_y), *racking = outputs
        across = np.zeros_like(x)
        for theta, free in racking:
            across, free_y = lever[:, None] * theta, free_y + lever * free
        nothing = np.zeros_like(y)
        return cls(
            np.column_stack([free_x, free_y]), np.hstack([x, nothing]), np.hstack([across, y])
        )

    def at(self, p: Array) -> Array:
        """Places (r, 2)."""
        return np.asarray(self.free + np.column_stack([self.x @ p, self.y @ p]))

    def normal_equations(self, p: Array, rows: Rows, foot: Array, t: Array) -> tuple[Array, Array]:
        """H and g of ½pᵀHp + gᵀp, around p with the feet and directions (m, 2) found there."""
        m = len(rows.path)
        at = self.free
        across = np.sqrt(rows.weight)
        along = np.sqrt(ALONG) * across
        x, y = self.x[:m], self.y[:m]
        tx, ty = t[:, X, None], t[:, Y, None]
        J = np.vstack([across[:, None] * (tx * y - ty * x), along[:, None] * (tx * x + ty * y)])
        off = at[:m] - foot
        r = np.concatenate(
            [
                across * (t[:, X] * off[:, Y] - t[:, Y] * off[:, X]),
                along * (t * (at[:m] - rows.path)).sum(axis=1),
            ]
        )
        H, g = J.T @ J, J.T @ r
        for of_p, free, place in (
            (self.x, at[:, X], rows.hold[X]),
            (self.y, at[:, Y], rows.hold[Y]),
        ):
            weighted = rows.holding[:, None] * of_p[m:]
            H += weighted.T @ of_p[m:]
            g += weighted.T @ (free[m:] - place)
        return H, g


@dataclass(frozen=True, slots=True)
class Rows:
    """What is judged: path, direction (m, 2), weight (m,) of the samples around the hold.

    wide (m + …, 2): the path around each, of which ``window`` tells the rows; hold (2,): where
    the path stands; holding: weights of the rows in the hold.
    """

    path: Array
    direction: Array
    weight: Array
    candidates: Array
    hold: Array
    holding: Array

    @classmethod
    def of(cls, around: Surroundings, stop: Stop) -> Rows:
        """Of that stop."""
        a, b = stop.a, stop.b
        index = np.concatenate([np.arange(a - BESIDE, a), np.arange(b, b + BESIDE + BEYOND)])
        weight = np.where(around.extruding[index], 1.0, TRAVELLING)
        weight[index >= stop.ends] = 0.0
        weight[: BESIDE - stop.before] = 0.0
        if not stop.after:
            weight[BESIDE:] = 0.0
        near = index[:, None] + np.arange(-NEAREST, NEAREST + 1)
        candidates = around.path[near]
        ahead = candidates[:, NEAREST + 1] - candidates[:, NEAREST]
        holding = np.full(len(judged(b - a)), STANDING)
        if around.extruding[b : b + SOON].any():
            holding[-1:] = ARRIVING
        return cls(
            around.path[index], _unit(ahead, np.array([1.0, 0.0])), weight, candidates,
            around.path[a], holding,
        )  # fmt: skip

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


def _unit(vector: Array, otherwise: Array) -> Array:
    """Directions (m, 2); where there is none, another's."""
    length = np.hypot(vector[:, X], vector[:, Y])[:, None]
    return np.asarray(np.where(length > 1e-7, vector / np.maximum(length, 1e-7), otherwise))
