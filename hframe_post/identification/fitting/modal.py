"""A sum of modes behind a delay, fitted to a measured frequency response.

    H(f) = g·e^{−sτ}·sinc²(f·Ts)·(Σ (c_i + d_i p_i) / (p_i² + 2ζ_i p_i + 1) + Σ b_k / (1 + s/ω_k))
    p_i = s/ω_i,  s = 2πjf

=============  ==========================================================================
``ω_i, ζ_i``   natural frequency (inside the measured band) and damping ratio of a mode
``c_i, d_i``   what it contributes to the motion, by position and by speed
``b_k, ω_k``   the same of a lag of first order
``g``          gain of the sensor: at rest a printer stands where it is told to, G(0) = 1
``τ``          delay of printer and recording together
=============  ==========================================================================

sinc² is how the command is played: as straight lines between samples of Ts. Racking follows
acceleration: two zeros at rest, or one where the structure says so; its g is not known from it.

For given ω_i, ζ_i and τ the rest is a linear problem that each step solves exactly (variable
projection). Modes are added one at a time, each from the best of a grid of starts.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg, optimize

from hframe_post.arrays import TS, Array, Complex
from hframe_post.identification.fitting.discrete import Term, delayed, held
from hframe_post.identification.fitting.weighting import SENSOR
from hframe_post.model.transfer_function import TransferFunction

DAMPING = (0.004, 1.0)  # of a mode
DAMPINGS = (0.03, 0.15, 0.6)  # from which the search of a new mode starts,
STARTS = 10  # at so many frequencies of the band,
REFINED = 3  # of which the best so many are refined
LONGEST_DELAY = 5e-3  # s, of a printer
DELAY_STEP = 1e-3  # s between starts
COARSE = 250  # frequencies that are enough to search with


@dataclass(frozen=True, slots=True)
class Structure:
    """What a model may be made of. modes, lags: how many; speed: whether d_i are free;
    zeros_at_rest: 0 for a position, 1 or 2 for racking."""

    modes: int
    speed: bool
    lags: int = 0
    zeros_at_rest: int = 0

    @property
    def unknowns(self) -> int:
        """Free numbers, with the delay."""
        linear = self.modes * (1 + self.speed) + self.lags - self.zeros_at_rest
        return 2 * self.modes + self.lags + linear + 1

    @property
    def order(self) -> int:
        """Poles, without those of a delay."""
        return 2 * self.modes + self.lags


@dataclass(frozen=True, slots=True)
class Data:
    """What is fitted, (k,) each; weight is one over the standard deviation of H.

    modes_hz: where modes may lie. gain: of the sensor, as expected: mean and standard deviation.
    """

    hz: Array
    H: Complex
    weight: Array
    modes_hz: tuple[float, float]
    delay_bounds: tuple[float, float]
    gain: tuple[float, float] = SENSOR

    @property
    def s(self) -> Complex:
        """Laplace's s, rad/s."""
        return np.asarray(2j * np.pi * self.hz)


@dataclass(frozen=True, slots=True)
class Place:
    """Where modes and lags lie: omega, zeta (modes,), corner (lags,) in rad/s; delay: s."""

    omega: Array
    zeta: Array
    corner: Array
    delay: float

    def __len__(self) -> int:
        return 2 * len(self.omega) + len(self.corner)


@dataclass(frozen=True, slots=True)
class Modal:
    """A fitted sum of modes and lags. coefficients: c, then d (if any), then b, with g in them;
    cost: of the weighted residual."""

    structure: Structure
    place: Place
    coefficients: Array
    cost: float

    @property
    def c(self) -> Array:
        """By position, (modes,)."""
        return self.coefficients[: self.structure.modes]

    @property
    def d(self) -> Array:
        """By speed, (modes,)."""
        n = self.structure.modes
        return self.coefficients[n : 2 * n] if self.structure.speed else np.zeros(n)

    @property
    def b(self) -> Array:
        """Of the lags, (lags,)."""
        return self.coefficients[len(self.coefficients) - self.structure.lags :]

    @property
    def delay(self) -> float:
        """τ, s."""
        return self.place.delay

    @property
    def gain(self) -> float:
        """g, where the model is of a position."""
        return float(self.c.sum() + self.b.sum())

    def response(self, hz: Array) -> Complex:
        """H at ``hz`` (k,), with gain and delay."""
        s = np.asarray(2j * np.pi * hz)
        played = np.sinc(hz * TS) ** 2 * np.exp(-s * self.place.delay)
        return np.asarray(played * (_columns(s, self.structure, self.place) @ self.coefficients))

    def discrete(self, delay: float, gain: float) -> TransferFunction:
        """The model divided by ``gain`` behind a delay (s), exact for straight lines of 1 ms."""
        place, terms = self.place, list[Term]()
        for w, z, c, d in zip(place.omega * TS, place.zeta, self.c, self.d, strict=True):
            F = w * np.array([[0.0, 1.0], [-1.0, -2.0 * z]])
            terms.append((F, w * np.array([0.0, 1.0]), np.array([c, d]) / gain))
        for w, b in zip(place.corner * TS, self.b, strict=True):
            terms.append((np.array([[-w]]), np.array([w]), np.array([b]) / gain))
        return delayed(held(terms, self.structure.zeros_at_rest), delay / TS)


def structures(racking: bool, most: int) -> Iterator[Structure]:
    """Those of up to ``most`` poles, from the fewest on; of each number the freest first."""
    for order in range(2, most + 1):
        for lags in (0, 1, 2):
            modes, odd = divmod(order - lags, 2)
            if odd or modes < 1:
                continue
            if not racking:
                yield Structure(modes, True, lags)
                if not lags:
                    yield Structure(modes, False)
                continue
            for zeros in (1, 2):
                if 2 * modes + lags > zeros:
                    yield Structure(modes, True, lags, zeros)


def fit(data: Data, structure: Structure, start: Modal | None = None) -> Modal:
    """The best model of that structure. start: one of the same structure, or simpler by a mode
    or a lag; none: simpler ones are fitted first."""
    if start is not None and start.structure == structure:
        return refined(data, structure, start.place)
    place = start.place if start else Place(np.zeros(0), np.zeros(0), np.zeros(0), np.nan)
    while len(place.omega) + len(place.corner) < structure.modes + structure.lags - 1:
        lag = len(place.omega) == structure.modes
        between = replace(structure, modes=len(place.omega) + (not lag),
                          lags=len(place.corner) + lag, zeros_at_rest=min(
                              structure.zeros_at_rest, 1))  # fmt: skip
        place = _extended(data, between, place).place
    return _extended(data, structure, place)


def _extended(data: Data, structure: Structure, place: Place) -> Modal:
    """The best model with one mode or lag more than ``place`` has."""
    low, high = 2.0 * np.pi * np.array(data.modes_hz)
    frequencies = np.geomspace(low * 1.2, high / 1.2, STARTS)
    first, last = data.delay_bounds
    count = 1 + int(np.ceil((last - first) / DELAY_STEP))
    delays = np.linspace(first, last, count) if np.isnan(place.delay) else [place.delay]
    coarse = thinned(data, COARSE // 2)

    def cost(start: Place) -> float:
        return float((_solve(coarse, structure, start)[0] ** 2).sum())

    # each of another frequency, as those of one end alike
    starts = [
        min((start for delay in delays for start in _with(place, structure, omega, delay)),
            key=cost)
        for omega in frequencies
    ]  # fmt: skip
    best = [refined(data, structure, start) for start in sorted(starts, key=cost)[:REFINED]]
    return min(best, key=lambda model: model.cost)


def _with(place: Place, structure: Structure, omega: float, delay: float) -> Iterator[Place]:
    """A mode more, or a lag where there are modes enough."""
    if len(place.omega) == structure.modes:
        yield Place(place.omega, place.zeta, np.append(place.corner, omega), delay)
        return
    for zeta in DAMPINGS:
        modes = np.append(place.omega, omega), np.append(place.zeta, zeta)
        yield Place(*modes, place.corner, delay)


def thinned(data: Data, count: int) -> Data:
    """Every k-th frequency, at least ``count`` where there are so many."""
    s = slice(None, None, max(1, len(data.hz) // count))
    return replace(data, hz=data.hz[s], H=data.H[s], weight=data.weight[s])


def refined(data: Data, structure: Structure, place: Place) -> Modal:
    """The least cost from a start."""
    n, k = structure.modes, structure.lags
    low, high = np.log(2.0 * np.pi * np.array(data.modes_hz))
    early, late = np.array(data.delay_bounds) / TS
    bounds = np.array(
        [[low, high]] * n + [list(np.log(DAMPING))] * n + [[low, high]] * k + [[early, late]]
    )
    x = np.concatenate(
        [np.log(place.omega), np.log(place.zeta), np.log(place.corner), [place.delay / TS]]
    )
    room = 1e-3 * (bounds[:, 1] - bounds[:, 0])
    x = np.clip(x, bounds[:, 0] + room, bounds[:, 1] - room)

    def at(x: Array) -> Place:
        return Place(
            np.exp(x[:n]), np.exp(x[n : 2 * n]), np.exp(x[2 * n : 2 * n + k]), float(x[-1]) * TS
        )

    for part, steps in _passes(data):
        x = optimize.least_squares(
            lambda v, part=part: _solve(part, structure, at(v))[0],
            x, bounds=(bounds[:, 0], bounds[:, 1]), x_scale="jac", max_nfev=steps,
            ftol=1e-6, xtol=1e-6,
        ).x  # fmt: skip
    r, coefficients = _solve(data, structure, at(x))
    return Modal(structure, at(x), coefficients, float(r @ r))


def _passes(data: Data) -> list[tuple[Data, int]]:
    """What is fitted, and in how many steps: a part of the frequencies, then all."""
    if len(data.hz) < 2 * COARSE:
        return [(data, 30)]
    return [(thinned(data, COARSE), 30), (data, 6)]


def _columns(s: Complex, structure: Structure, place: Place) -> Complex:
    """Responses of the modes by position, by speed if that is free, and of the lags."""
    p = s[:, None] / place.omega
    one = 1.0 / (p * p + 2.0 * place.zeta * p + 1.0)
    lags = 1.0 / (1.0 + s[:, None] / place.corner)
    return np.hstack([one, p * one, lags] if structure.speed else [one, lags])


def _solve(data: Data, structure: Structure, place: Place) -> tuple[Array, Array]:
    """Weighted residual (2k + 1,) and the best coefficients."""
    s = data.s
    A = _columns(s, structure, place)
    A = A * (data.weight * np.sinc(data.hz * TS) ** 2 * np.exp(-s * place.delay))[:, None]
    target = data.weight * data.H
    rows, wanted = np.vstack([A.real, A.imag]), np.append(target.real, target.imag)
    at_rest = _at_rest(structure)
    racks = structure.zeros_at_rest > 0
    expected, sd = data.gain
    rows = np.vstack([rows, at_rest * (0.0 if racks else 1.0 / sd)])
    wanted = np.append(wanted, 0.0 if racks else expected / sd)
    free = _free(structure, place)
    reduced = rows @ free
    scale = np.maximum(np.sqrt(np.einsum("ij,ij->j", reduced, reduced)), 1e-300)
    x = linalg.lstsq(reduced / scale, wanted, cond=1e-9, lapack_driver="gelsy", check_finite=False)[
        0
    ]
    x = x / scale
    return np.asarray(wanted - reduced @ x), np.asarray(free @ x)


def _at_rest(structure: Structure) -> Array:
    """What each coefficient contributes at rest."""
    n, k = structure.modes, structure.lags
    return np.concatenate([np.ones(n), np.zeros(n * structure.speed), np.ones(k)])


def _free(structure: Structure, place: Place) -> Array:
    """Directions in which coefficients may go, with the zeros at rest."""
    at_rest = _at_rest(structure)
    if structure.zeros_at_rest == 0:
        return np.eye(len(at_rest))
    rows = [at_rest]
    if structure.zeros_at_rest == 2:  # the slope of all terms over s at rest, too
        unit = place.omega.min()
        speed = unit / place.omega
        rows.append(np.concatenate([-2.0 * place.zeta * speed, speed, -unit / place.corner]))
    return np.asarray(linalg.null_space(np.array(rows)))
