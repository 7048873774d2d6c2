"""What becomes of a command: its limits, the nozzle's way, its distance from the path, the line."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hframe_post.arrays import TS, Array, Flags, Integers
from hframe_post.native import compiled, kernels


def finite_filter(taps: Array, u: Array, n: int, late: int, rest: float, lag: float) -> Array:
    """Return the output of a filter at the last n samples of u (h,).

    taps (m,): by acceleration, that of the oldest sample first; rest: gain of the input ``late``
    samples before; lag: samples, of its speed. h is at least n + 1 + the greater of m and ``late``.
    """
    y, room = np.empty(n), np.empty(n + len(taps))
    kernels.finite_filter(taps, len(taps), u, len(u), late, rest, lag, n, room, y)
    return y


@compiled
def coarse_filter(
    taps: Array, late: int, rest: float, lag: float, u: Array, first: int, count: int, every: int, /
) -> Array:
    """Return the output (count,) of a filter at every n-th (``every``, even) sample from first on.

    taps (m,): by acceleration over two samples, that of the oldest first, which comes ``late``
    samples after its output. u (h,) has 2·m + 4 − late samples before the first and ``late`` after
    the last output. Single precision misses a deviation by a millionth.
    """


def sliding_sums(factors: Array, u: Array) -> Array:
    """Return the sum of the factors times as many samples of u, from each sample that has them."""
    sums = np.zeros(len(u) + 1 - len(factors))
    kernels.sliding_sums(factors, len(factors), u, len(sums), sums)
    return sums


# ----------------------------------------------------------------------
# The way from a path to the nozzle. The path counts within NEAREST samples of each. Where it is a
# straight line, the distance is that to the line; elsewhere the nearest sample is found first, then
# the nearer of the two segments that meet there.


@compiled
def distances(path: Array, nozzle: Array, at: Integers, /) -> Array:
    """Return the distance (k,) of the nozzle (p, 2) to a path (p, ≥2) at samples ``at`` (k,)."""


@compiled
def judge_window(
    xyze: Array, sliced: bool, commands: Array, taps: Array, counts: Integers, late: Integers,
    gains: Array, x_c: float, first: int, begin: int, stop: int, every: int, apart: int, /,
) -> tuple[Integers, Flags, Array, Array, Array]:  # fmt: skip
    """Return how far the nozzle is off a path xyze (n, 4) with each of s commands (s, n, 2).

    sliced: whether the path is a command, too, before the given ones.

    taps: of the responses of x, of y and, if there are three, of racking, one after the other, of
    which counts (r,) says how many each has; late (r,): see ``coarse_filter``; gains (r, 2): gain
    at rest and lag. x_c: where the lever arm is 0, mm. Around its samples a command rests.

    The path is judged where it moves, at every n-th (``every``) sample from ``first`` to before
    ``stop``: where that is (k,); whether it extrudes there (k,); the nozzle's x, y at all samples
    from ``begin`` on, ``apart``, (s·m·2,); by strategy, the way to it from the path (k, s·2), and
    its length (k, s).
    """


def play(ends: Integers, at: Array, first: int, command: Array) -> None:
    """Write where segments are into a command (n, 2), whose first sample is ``first``.

    ends (k,), ascending: samples at which they end; at (k, 2): the places there. Samples up to the
    first end and after the last stay as they are.
    """
    kernels.play(ends, at, len(ends), first, len(command), command)


# ----------------------------------------------------------------------
# How far a printed line's width is off, piece by piece.


def line_pieces(
    path: Array, nozzle: Array, laid: Array, piece: float, begun: Array
) -> tuple[Integers, Array, Array]:
    """Return before which samples (k,) pieces end, |w − 1| (k,) of each, and the open piece.

    path (n, 4), nozzle (n, 2): the first sample is the last one of before. laid (n,): filament that
    comes out in the step to each. w: filament laid over filament wanted, which is what the path's
    flow would lay on the nozzle's way. A line ends where
    the path stands or nothing is extruded. Its pieces are ``piece`` long, in mm of the nozzle's
    way, and a rest of less than half does not count. begun (4,): how far an open piece is beyond
    the place where it should have begun, and its sums; zeros if no piece is open.
    """
    n, after = len(path), begun.copy()
    if n < 2:
        return np.zeros(0, np.int64), np.zeros(0), after
    at, errors = np.empty(n, np.int64), np.empty(n)
    nozzle = np.ascontiguousarray(nozzle)
    count = kernels.line_pieces(path, nozzle, laid, n, piece, after, at, errors)
    return at[:count], errors[:count], after


# ----------------------------------------------------------------------
# Pieces of a picture.

Table = NDArray[np.float32]


@compiled
def draw_pieces(
    xyze: Array, line: Integers, at: Integers, start: int, extruding: Flags, runs: Integers,
    places: Integers, begins: bool, nozzle: Array, begin: int, apart: int, off: Array,
    errors: Array, alike: int, length: float, near: float, off_line: float, sums: Array,
    table: Table, /,
) -> int:  # fmt: skip
    """Fill a table (k, 7 + 5·s) with pieces that end at samples of a window; return their number.

    xyze (n, 4), line (n,): a path and its lines, whose window begins at ``start``; at (k,) counts
    from there. runs (r,): where in the window layers and features begin; places (r, 2): their
    numbers. begins: whether the first piece does. See ``Judgement`` for the rest of what is drawn,
    ``join_pieces`` for which pieces are left, and ``Pieces`` for what each holds. To sums
    (r, 2, 1 + s) number and squared errors of samples that extrude, then of others, are added.
    """


@compiled
def join_pieces(
    table: Table, strategies: int, alike: int, length: float, near: float, off: float, /
) -> int:
    """Join neighbours in a table pair by pair; return how many pieces are left, the first ones.

    Their numbers from column ``alike`` on are equal. Pieces are joined up to a length, if x and y
    stay ``near`` their line, and the ways off the path are off theirs by less than ``off``. If
    alike is behind the last number, any are.
    """


# ----------------------------------------------------------------------
# Checks of every sample of a command.


def peaks_if_safe(
    xyze: Array, command: Array, before: Array, limits: Array, belts: Array
) -> Array | None:
    """Return the greatest rates of a command (n, 2) for a path xyze (n, 4), if it is safe.

    It is if all is finite and within limits (8,): least and greatest z of the path, x and y of the
    command, then velocity and acceleration of the belts. before (2, 2): the two samples of the
    command before it; belts (2, 2): from x, y to the belts. The result (4,): velocity and
    acceleration of the belts, acceleration in x and in y.
    """
    command, peaks = np.ascontiguousarray(command), np.zeros(4)
    if kernels.safe(xyze, command, len(command), before, limits, belts, TS, peaks):
        return peaks
    return None


def is_near(xyze: Array, command: Array, most: float) -> bool:
    """Return whether a command (n, 2) is nowhere over ``most`` mm off its path xyze (n, 4)."""
    return not kernels.far_off(xyze, np.ascontiguousarray(command), len(command), most)
