"""What a stop is judged by: the nozzle's distance to the path, most of all while it extrudes.

Symbols are those of ``model.stop``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hframe_post.arrays import Array, Flags, Integers, X, Y

BESIDE = 100  # samples before and after a hold in which its command may change
BEYOND = 100  # samples after these that are judged too: ringing shows there
NEAREST = 24  # samples to either side in which the path's nearest point is sought

# weights of a sample's squared deviation across the path; 1 while it extrudes
TRAVELLING = 0.03  # while it does not
STANDING = 0.04  # in the hold
ARRIVING = 1.0  # at the end of a hold from which an extrusion begins
ALONG = 0.01  # times any of these, for the deviation along the path
FAR = 0.05  # mm off the path beyond which an extruding sample gets more weight


def _thinned(n: int) -> tuple[Integers, Array]:
    """Return which of n samples next to a hold are judged, nearest first, and for how many each."""
    near, middle, far = np.arange(24), np.arange(24, 60, 2), np.arange(60, n, 4)
    counted = np.repeat([1.0, 2.0, 4.0], [len(near), len(middle), len(far)])
    return np.concatenate([near, middle, far]), counted


BEFORE, COUNTED_BEFORE = (each[::-1] for each in _thinned(BESIDE))
BEFORE = BESIDE - 1 - BEFORE  # counted from sample a − BESIDE
AFTER, COUNTED_AFTER = _thinned(BESIDE + BEYOND)  # counted from sample b


def judged_samples(stop: Stop) -> Integers:
    """Return which samples of a stretch are judged around a hold."""
    return np.concatenate([stop.a - BESIDE + BEFORE, stop.b + AFTER])


def judged_in_hold(n: int) -> list[int]:
    """Return which samples of a hold of n are judged: as the nozzle swings, and the last one."""
    return [*range(3, min(n, 64) - 1, 4), n - 1] if n else []


def reweighted(ratio: Array, gain: float, most: float) -> Array:
    """Return the factors of least-squares weights for rows at ``ratio`` (n,) of their target.

    A row beyond its target gets more weight: gain·ratio², at most ``most`` times.
    """
    return np.where(ratio > 1.0, np.minimum(gain * np.square(ratio), most), 1.0)


@dataclass(frozen=True, slots=True)
class Stop:
    """A stop in a stretch of samples: the command stands from sample a to b − 1.

    before, after: samples on either side that may change; movable: whether the place of the hold
    may. ends: the first sample after b that is not judged, because another stop begins there.
    """

    a: int
    b: int
    before: int
    after: int
    movable: bool
    ends: int


@dataclass(frozen=True, slots=True)
class Surroundings:
    """n samples of a stretch: path (n, 2) from its origin (2,), mm; extruding (n,)."""

    path: Array
    origin: Array
    extruding: Flags


@dataclass(frozen=True, slots=True)
class Rows:
    """The m judged samples around a hold and those in it.

    path, direction (m, 2), weight (m,); extruding (m,): which count as printed; candidates
    (m, 2·NEAREST + 1, 2): the path around each; hold (2,): where the path stands; hold_weight:
    of the samples in the hold.
    """

    path: Array
    direction: Array
    weight: Array
    extruding: Flags
    candidates: Array
    hold: Array
    hold_weight: Array

    @classmethod
    def from_stop(cls, around: Surroundings, stop: Stop) -> Rows:
        """Return the rows of a stop with their first weights."""
        a, b = stop.a, stop.b
        index = judged_samples(stop)
        after = COUNTED_AFTER if stop.after else 0.0 * COUNTED_AFTER
        counted = np.concatenate([COUNTED_BEFORE, after])
        weight = np.where(around.extruding[index], counted, TRAVELLING * counted)
        weight[(index >= stop.ends) | (index < a - stop.before)] = 0.0
        candidates = around.path[index[:, None] + np.arange(-NEAREST, NEAREST + 1)]
        ahead = candidates[:, NEAREST + 1] - candidates[:, NEAREST]
        hold_weight = np.full(len(judged_in_hold(b - a)), STANDING)
        if around.extruding[b : b + 25].any():
            hold_weight[-1:] = ARRIVING
        return cls(
            around.path[index], _unit(ahead, np.array([1.0, 0.0])), weight,
            around.extruding[index] & (weight > 0.0), candidates, around.path[a], hold_weight,
        )  # fmt: skip

    def nearest(self, at: Array) -> tuple[Array, Array]:
        """Return the path's nearest points to the nozzle and its directions there, (m, 2)."""
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

    def off(self, at: Array) -> Array:
        """Return how far the nozzle is from the path, (m,), mm; 0 where it does not extrude."""
        foot, _ = self.nearest(at)
        off = at[: len(foot)] - foot
        return np.where(self.extruding, np.hypot(off[:, X], off[:, Y]), 0.0)

    def emphasised(self, off: Array) -> Rows:
        return replace(self, weight=self.weight * reweighted(off / FAR, gain=1.5, most=10.0))


@dataclass(frozen=True, slots=True)
class Nozzle:
    """The nozzle at the judged samples: known (r, 2), plus what p adds, whose halves are x and y.

    x, y (r, k): by their own halves of p; across (r, k): y by that of x, where the gantry racks.
    """

    known: Array
    x: Array
    across: Array
    y: Array

    @classmethod
    def from_outputs(cls, outputs: list[tuple[Array, Array]], lever: Array) -> Nozzle:
        """Return the nozzle from the filters' outputs: eq. 1 and 2, with the path's lever arm."""
        (x, known_x), (y, known_y), *racking = outputs
        across = np.zeros_like(x)
        for theta, known in racking:
            across, known_y = lever[:, None] * theta, known_y + lever * known
        return cls(np.column_stack([known_x, known_y]), x, across, y)

    def at(self, p: Array) -> Array:
        p_x, p_y = p.reshape(2, -1)
        moved = np.column_stack([self.x @ p_x, self.across @ p_x + self.y @ p_y])
        return np.asarray(self.known + moved)

    def normal_equations(self, rows: Rows, foot: Array, t: Array) -> tuple[Array, Array]:
        """Return H and g of ½pᵀHp + gᵀp, the weighted squares, for feet and directions (m, 2)."""
        m, k = len(rows.path), self.x.shape[1]
        normal = np.sqrt(rows.weight)
        along = np.sqrt(ALONG) * normal
        x, across, y = self.x[:m], self.across[:m], self.y[:m]
        J, r = np.empty((2 * m, 2 * k)), np.empty(2 * m)
        for half, place, n_x, n_y in (
            (slice(0, m), foot, -normal * t[:, Y], normal * t[:, X]),
            (slice(m, None), rows.path, along * t[:, X], along * t[:, Y]),
        ):
            J[half, :k] = n_x[:, None] * x + n_y[:, None] * across
            J[half, k:] = n_y[:, None] * y
            off = self.known[:m] - place
            r[half] = n_x * off[:, X] + n_y * off[:, Y]
        H, g = J.T @ J, J.T @ r
        y_by_p = np.hstack([self.across[m:], self.y[m:]])
        for part, by_p, axis in ((slice(0, k), self.x[m:], X), (slice(None), y_by_p, Y)):
            weighted = rows.hold_weight[:, None] * by_p
            H[part, part] += weighted.T @ by_p
            g[part] += weighted.T @ (self.known[m:, axis] - rows.hold[axis])
        return H, g


def _unit(vector: Array, otherwise: Array) -> Array:
    """Return directions (m, 2), or another's where a vector is too short to have one."""
    length = np.hypot(vector[:, X], vector[:, Y])[:, None]
    return np.asarray(np.where(length > 1e-7, vector / np.maximum(length, 1e-7), otherwise))
