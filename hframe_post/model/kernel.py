"""A plant's inverse as taps, for compensation inside the firmware's host ("live").

The host convolves the path of its own planner with the taps once a millisecond and plays the
results c as control points of a uniform cubic B-spline (Appendix B, degree 3, L = 1), which has
continuous acceleration and never leaves the hull of its control points.

==========  ==============================================================  ==============
symbol      meaning                                                         source
==========  ==============================================================  ==============
``G, D``    response of an axis, and what taps through it shall be          eq. 1, 2
``h``       taps h[k], k = −ahead … past: path (k < 0: ahead) → c
``B``       (2 + cos ω)/3, what the spline makes of its control points      eq. 37
``W``       spectrum of a print's path: 1/f⁴, flat below ``CORNER_HZ``
``λ``       effort: weight of the acceleration of c                         eq. 12, lpfbs
``A, m``    constraints A·h = m: Σ h = D(0), Σ k·h = lag_D − D(0)·lag_G
==========  ==============================================================  ==============

h minimises Σ W·(|G·B·h − D|² + λ·|ω²·B·h|²), expected over what is not known of G (its doubts). So
H·h = r + Aᵀμ with a Toeplitz matrix H, subject to A·h = m: rest and constant speed are exact. An
axis has D = 1. What a command of axis j adds to another axis (eq. 13, 19) is taken off its target
by taps with G = Gjj and D the coupling. Common poles of both cancel: these taps are short.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from hframe_post.arrays import TS, Array, Complex, X, Y
from hframe_post.errors import ArgumentError
from hframe_post.hosts.klipper.kernel_file import AHEAD, TAPS
from hframe_post.model.impulse_response import ImpulseResponse
from hframe_post.model.kinematics import Kinematics, Trapezoid
from hframe_post.model.plant import Plant, Racking, nozzle

OMEGA = np.linspace(0.0, np.pi, 4097)  # rad/sample, of the least squares; 0.12 Hz apart
CORNER_HZ = 4.0  # moves of a print last about 1/4 s; from 2 to 8 Hz the error changes by 2 %
PAST = TAPS - 1 - AHEAD
EFFORTS = tuple(10.0 ** (k / 4.0) for k in range(17))  # λ = 1 … 10⁴
# of a measured model: on next sessions of two Vorons and an SV08 the mean error is the least from
# 10 to 30, and 60 ms ahead instead of 100 leave up to 9 % more
MEASURED_EFFORTS = EFFORTS[5:]  # λ = 18 … 10⁴


@dataclass(frozen=True, slots=True)
class Bounds:
    """Limits of the path (mm/s, mm/s², corner mm/s) and of the belts, and a place on the bed."""

    velocity: float
    acceleration: float
    corner: float
    belt_velocity: float
    belt_acceleration: float
    place: tuple[float, float]

    def times(self, k: float) -> Bounds:
        """Return the bounds of a path with k times the acceleration and corner speed."""
        return replace(self, acceleration=k * self.acceleration, corner=k * self.corner)


@dataclass(frozen=True, slots=True)
class Figures:
    """What the test path shows. leaves, without: RMS error (mm) with and without compensation.

    without: less the plant's lag, which shows in no print. deviation: the most that a command
    leaves the path in x or y, mm. reserve: factor on the path's acceleration and corner speed up
    to which the belts can follow.
    """

    leaves: float
    without: float
    deviation: float
    reserve: float


@dataclass(frozen=True, slots=True)
class Kernel:
    """Taps h (``TAPS``,) of x and y, and of what racking adds, for the path of x.

    h[0] belongs to the path ``AHEAD`` samples later.
    """

    axes: tuple[Array, Array]
    racking: tuple[Racking, Array] | None

    @property
    def reach(self) -> int:
        """Return the number of path samples on either side on which a sample depends."""
        return (2 if self.racking else 1) * PAST + 1

    def command(self, path: Array) -> Array:
        """Return the control points (n, 2) for a path (n, 2), mm, at rest at both ends."""
        target = path.copy()
        if self.racking:
            racking, h = self.racking
            target[:, Y] -= racking.lever(path) * _convolved(h, path[:, X])
        return np.column_stack([_convolved(self.axes[axis], target[:, axis]) for axis in (X, Y)])

    def run(self, path: Array) -> Array:
        """Return what the motors follow (n, 2) for a path (n, 2), mm, at rest at both ends."""
        return played(self.command(path))


def _convolved(h: Array, path: Array) -> Array:
    return np.convolve(np.pad(path, (PAST, AHEAD), mode="edge"), h, mode="valid")


def played(c: Array) -> Array:
    """Return where the spline of control points (n, 2) is at its samples, (n, 2)."""
    padded = np.pad(c, ((1, 1), (0, 0)), mode="edge")
    return np.asarray((padded[:-2] + 4.0 * padded[1:-1] + padded[2:]) / 6.0)


def kernel(plant: Plant, kinematics: Kinematics, bounds: Bounds) -> tuple[Kernel, Figures]:
    """Return the kernel of a plant, as mild as the belts need, and its figures.

    Raises ArgumentError if the command outruns the belts at any effort.
    """
    path = strokes(bounds)
    most_v, most_a = bounds.belt_velocity, bounds.belt_acceleration
    G = tuple(map(Spectrum.of, plant.responses))
    measured, racking = any(each.variance.any() for each in G), plant.racking
    for effort in MEASURED_EFFORTS if measured else EFFORTS:
        axes = taps(G[X], None, effort), taps(G[Y], None, effort)
        made = Kernel(axes, (racking, taps(G[X], G[2], effort)) if racking else None)
        command = made.command(path)
        v, a = _rates(kinematics, command)
        if v <= most_v and a <= most_a:
            break
    else:
        raise ArgumentError(
            f"the command would need {v:.0f} mm/s and {a:.0f} mm/s² of the belts, whose limits are "
            f"{most_v:g} and {most_a:g}: lower velocity or acceleration under [limits]"
        )
    n = np.arange(len(path))
    late = np.column_stack([np.interp(n - G[axis].lag, n, path[:, axis]) for axis in (X, Y)])
    leaves = _rms(nozzle(plant, path[0], played(command)) - path)
    without = _rms(nozzle(plant, path[0], path) - late)
    deviation = float(np.abs(command - path).max())
    for reserve in (most_a / a, max(0.9 * most_a / a, 1.0), 1.0):  # strokes add up in other ways
        v, a = _rates(kinematics, made.command(strokes(bounds.times(reserve))))
        if v <= most_v and a <= most_a:
            break
    return made, Figures(leaves, without, deviation, reserve)


def _rates(kinematics: Kinematics, command: Array) -> tuple[float, float]:
    """Return the greatest speed and acceleration of the belts."""
    v, a = (kinematics.belts(*np.diff(command.T, n=k)) / TS**k for k in (1, 2))
    return float(np.abs(v).max()), float(np.abs(a).max())


@dataclass(frozen=True, slots=True)
class Spectrum:
    """A response at ``OMEGA``, at rest and at low speed; variance: of what is not known of it."""

    at: Complex
    variance: Array
    rest: float
    lag: float

    @classmethod
    def of(cls, G: ImpulseResponse) -> Spectrum:
        slow = 1e-5  # rad/sample
        lag = -G.response(np.array([slow])).imag[0] / slow
        variance = np.zeros(len(OMEGA))
        for doubt in G.doubts:
            variance += np.abs(doubt.response(OMEGA)) ** 2
        return cls(G.response(np.maximum(OMEGA, 1e-9)), variance, G.dc_gain, float(lag))


def taps(G: Spectrum, D: Spectrum | None, effort: float) -> Array:
    """Return the taps (``TAPS``,) that make of G what D is, or 1 without D."""
    from scipy.linalg import solve_toeplitz  # takes a second to import

    hz = OMEGA / (2.0 * np.pi * TS)
    W = 1.0 / (hz**4 + CORNER_HZ**4)
    W /= W.mean()
    B = (2.0 + np.cos(OMEGA)) / 3.0
    GB = G.at * B
    wanted, rest, lag = (1.0, 1.0, 0.0) if D is None else (D.at, D.rest, D.lag)
    k = np.arange(-AHEAD, PAST + 1)
    acceleration = (2.0 - 2.0 * np.cos(OMEGA)) * B
    expected = np.abs(GB) ** 2 + G.variance * B**2
    H = np.fft.irfft(W * (expected + effort * acceleration**2))[:TAPS]
    r = np.fft.irfft(W * np.conj(GB) * wanted)[k]
    A = np.stack([np.ones(TAPS), k / PAST])
    m = np.array([rest, (lag - rest * G.lag) / PAST])
    solved = solve_toeplitz(H, np.column_stack([r, A.T]))
    free, by_A = solved[:, 0], solved[:, 1:]
    h: Array = free + by_A @ np.linalg.solve(A @ by_A, m - A @ free)
    h[AHEAD] += rest - h.sum()  # to the last digit: a printer at rest stands at its path
    return h


def strokes(bounds: Bounds) -> Array:
    """Return the test path (n, 2): strokes of all lengths and directions at the path's limits.

    A hundred of them take 6 s.
    """
    rng = np.random.default_rng(1)
    lengths = np.geomspace(0.2, 60.0, 100)
    rng.shuffle(lengths)
    turns = rng.choice(np.arange(8) * np.pi / 4.0, len(lengths))
    away = np.column_stack([np.cos(turns), np.sin(turns)])
    away[1::2] = -away[::2]  # there and back: about the same place
    at, pieces, carry = np.array(bounds.place), [np.tile(bounds.place, (500, 1))], 0.0
    straight = (away[1:] * away[:-1]).sum(axis=1) >= -1e-9  # at most a square corner
    corners = [0.0, *np.where(straight, bounds.corner, 0.0).tolist(), 0.0]
    for length, way, ends in zip(lengths.tolist(), away, pairwise(corners), strict=True):
        reached = min((length * bounds.acceleration) ** 0.5, bounds.velocity)
        v_s, v_e = (min(v, reached) for v in ends)
        move = Trapezoid(length, bounds.velocity, bounds.acceleration, v_s, v_e)
        t = np.arange(carry, move.seconds, TS)
        pieces.append(at + np.outer(move.distance(t), way))
        carry = (carry - move.seconds) % TS
        at = at + length * way
    return np.concatenate([*pieces, np.tile(at, (1000, 1))])


def _rms(error: Array) -> float:
    return float(np.sqrt((error**2).sum(axis=1).mean()))
