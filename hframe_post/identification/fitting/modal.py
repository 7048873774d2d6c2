"""A sum of modes behind a delay, fitted to a measured frequency response.

    H(f) = g·e^{−sτ}·sinc²(f·Ts)·(Σ (c_i + d_i p_i) / (p_i² + 2ζ_i p_i + 1) + Σ b_k / (1 + s/ω_k))
    p_i = s/ω_i,  s = 2πjf

=============  ==========================================================================
``ω_i, ζ_i``   natural frequency and damping ratio of a mode
``c_i, d_i``   its contribution to the motion, by position and by speed
``b_k, ω_k``   contribution and corner frequency of a first-order lag
``g``          sensor gain: at rest a printer stands where it was sent, so G(0) = 1
``τ``          delay of printer and recording together
=============  ==========================================================================

sinc² stands for the command, played as straight lines between samples of Ts. Racking follows
acceleration: it has two zeros at rest, or one where the structure says so, and does not tell g.

For given ω_i, ζ_i, ω_k and τ the rest is a linear problem, solved exactly in each step (variable
projection). Modes are added one at a time, each from the best of a grid of starts.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from scipy import linalg, optimize

from hframe_post.arrays import TS, Array, Complex, Flags
from hframe_post.identification.fitting.discrete import Term, delayed, discretize
from hframe_post.identification.responses.frequency_response import SENSOR
from hframe_post.model.transfer_function import TransferFunction

DAMPING = (0.004, 1.0)  # bounds of a mode's damping ratio
COARSE = 250  # frequencies that are enough to search with


@dataclass(frozen=True, slots=True)
class Structure:
    """Number of modes and lags of a model.

    speed: whether d_i are free. zeros_at_rest: 0 for a position, 1 or 2 for racking.
    """

    modes: int
    speed: bool
    lags: int = 0
    zeros_at_rest: int = 0

    @property
    def unknowns(self) -> int:
        """Return the number of free parameters, including the delay."""
        linear = self.modes * (1 + self.speed) + self.lags - self.zeros_at_rest
        return 2 * self.modes + self.lags + linear + 1

    @property
    def order(self) -> int:
        """Return the number of poles, without those of the delay."""
        return 2 * self.modes + self.lags


@dataclass(frozen=True, slots=True)
class Parameters:
    """The nonlinear parameters: omega, zeta (modes,), corner (lags,) in rad/s, and delay in s."""

    omega: Array
    zeta: Array
    corner: Array
    delay: float


class Expectation(Protocol):
    """What is known of a model before its recording is seen."""

    def rows(self, structure: Structure, parameters: Parameters) -> tuple[Array, Array]:
        """Return rows (r, coefficients), and what they give (r,) for the expected printer.

        In units of standard deviations.
        """


@dataclass(frozen=True, slots=True)
class Data:
    """The response H (k,) to fit, with weight (k,), one over its standard deviation.

    mode_range_hz, delay_bounds (s): bounds of modes and delay. sensor: mean and standard deviation
    of the gain that is expected. damping: bounds of damping ratios. prior: what is known without
    the recording.
    """

    hz: Array
    H: Complex
    weight: Array
    mode_range_hz: tuple[float, float]
    delay_bounds: tuple[float, float]
    sensor: tuple[float, float] = SENSOR
    damping: tuple[float, float] = DAMPING
    prior: Expectation | None = None

    def thinned(self, count: int) -> Data:
        """Return every k-th frequency, so that at least ``count`` remain."""
        s = slice(None, None, max(1, len(self.hz) // count))
        return replace(self, hz=self.hz[s], H=self.H[s], weight=self.weight[s])


@dataclass(frozen=True, slots=True)
class Modal:
    """A fitted sum of modes and lags.

    coefficients: c, then d (if any), then b, each times the gain g. cost: sum of squares of the
    weighted residual. mode_range_hz: bounds within which modes were sought.
    """

    structure: Structure
    parameters: Parameters
    coefficients: Array
    cost: float
    mode_range_hz: tuple[float, float]

    @property
    def c(self) -> Array:
        """Return the modes' contributions by position, (modes,)."""
        return self.coefficients[: self.structure.modes]

    @property
    def d(self) -> Array:
        """Return the modes' contributions by speed, (modes,)."""
        n = self.structure.modes
        return self.coefficients[n : 2 * n] if self.structure.speed else np.zeros(n)

    @property
    def b(self) -> Array:
        """Return the contributions of the lags, (lags,)."""
        return self.coefficients[len(self.coefficients) - self.structure.lags :]

    @property
    def delay(self) -> float:
        return self.parameters.delay

    @property
    def gain(self) -> float:
        """Return g of a position; of racking this is 0."""
        return float(self.c.sum() + self.b.sum())

    def without(self, gone: Flags) -> Modal:
        """Return the model without the modes that are flagged (modes,)."""
        kept, lags = ~gone, np.ones(self.structure.lags, dtype=bool)
        old = self.parameters
        parameters = replace(old, omega=old.omega[kept], zeta=old.zeta[kept])
        structure = replace(self.structure, modes=int(kept.sum()))
        parts = [kept, kept, lags] if structure.speed else [kept, lags]
        coefficients = self.coefficients[np.concatenate(parts)]
        return replace(self, structure=structure, parameters=parameters, coefficients=coefficients)

    def response(self, hz: Array) -> Complex:
        """Return H at ``hz`` (k,), including gain and delay."""
        s = np.asarray(2j * np.pi * hz)
        played = np.sinc(hz * TS) ** 2 * np.exp(-s * self.delay)
        return np.asarray(
            played * (columns(s, self.structure, self.parameters) @ self.coefficients)
        )

    def discrete(self, delay: float, gain: float) -> TransferFunction:
        """Return the model divided by ``gain`` behind ``delay`` (s), at 1 kHz."""
        parameters, terms = self.parameters, list[Term]()
        modes = zip(parameters.omega * TS, parameters.zeta, self.c, self.d, strict=True)
        for w, z, c, d in modes:
            F = w * np.array([[0.0, 1.0], [-1.0, -2.0 * z]])
            terms.append((F, w * np.array([0.0, 1.0]), np.array([c, d]) / gain))
        for w, b in zip(parameters.corner * TS, self.b, strict=True):
            terms.append((np.array([[-w]]), np.array([w]), np.array([b]) / gain))
        return delayed(discretize(terms, self.structure.zeros_at_rest), delay / TS)


def structures(racking: bool, max_poles: int) -> Iterator[Structure]:
    """Yield structures by number of poles, ascending; with equal poles the freest first."""
    for order in range(2, max_poles + 1):
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
    """Return the best model of ``structure``.

    start: a model with one mode or lag less. Without it, simpler models are fitted first.
    """
    nothing = Parameters(np.zeros(0), np.zeros(0), np.zeros(0), np.nan)
    parameters = start.parameters if start else nothing
    while len(parameters.omega) + len(parameters.corner) < structure.modes + structure.lags - 1:
        modes, lags = len(parameters.omega), len(parameters.corner)
        add_lag = modes == structure.modes
        zeros = min(structure.zeros_at_rest, 1)
        simpler = Structure(modes + (not add_lag), structure.speed, lags + add_lag, zeros)
        parameters = _extended(data, simpler, parameters).parameters
    return _extended(data, structure, parameters)


def _extended(data: Data, structure: Structure, parameters: Parameters) -> Modal:
    low, high = 2.0 * np.pi * np.array(data.mode_range_hz)
    first, last = data.delay_bounds
    count = 1 + int(np.ceil((last - first) / 1e-3))
    known = not np.isnan(parameters.delay)
    delays = [parameters.delay] if known else np.linspace(first, last, count)
    coarse = data.thinned(COARSE // 2)

    def cost(start: Parameters) -> float:
        return float((_solve(coarse, structure, start)[0] ** 2).sum())

    # the best start of each frequency: overall the best ones would all lie at one frequency
    starts = [
        min((start for delay in delays for start in _with(parameters, structure, omega, delay)),
            key=cost)
        for omega in np.geomspace(low * 1.2, high / 1.2, 10)
    ]  # fmt: skip
    best = [refine(data, structure, start) for start in sorted(starts, key=cost)[:3]]
    return min(best, key=lambda model: model.cost)


def _with(
    parameters: Parameters, structure: Structure, omega: float, delay: float
) -> Iterator[Parameters]:
    old = parameters
    if len(old.omega) == structure.modes:
        yield Parameters(old.omega, old.zeta, np.append(old.corner, omega), delay)
        return
    for zeta in (0.03, 0.15, 0.6):
        yield Parameters(np.append(old.omega, omega), np.append(old.zeta, zeta), old.corner, delay)


def refine(data: Data, structure: Structure, start: Parameters) -> Modal:
    n, k = structure.modes, structure.lags
    low, high = np.log(2.0 * np.pi * np.array(data.mode_range_hz))
    early, late = np.array(data.delay_bounds) / TS
    bounds = np.array(
        [[low, high]] * n + [list(np.log(data.damping))] * n + [[low, high]] * k + [[early, late]]
    )
    x = np.concatenate(
        [np.log(start.omega), np.log(start.zeta), np.log(start.corner), [start.delay / TS]]
    )
    room = 1e-3 * (bounds[:, 1] - bounds[:, 0])
    x = np.clip(x, bounds[:, 0] + room, bounds[:, 1] - room)

    def parameters(x: Array) -> Parameters:
        omega, zeta, corner = np.exp(x[:n]), np.exp(x[n : 2 * n]), np.exp(x[2 * n : 2 * n + k])
        return Parameters(omega, zeta, corner, float(x[-1]) * TS)

    # first on some of the frequencies, then a few steps on all
    coarse_first = len(data.hz) >= 2 * COARSE
    passes = [(data.thinned(COARSE), 30), (data, 6)] if coarse_first else [(data, 30)]
    for part, steps in passes:
        x = optimize.least_squares(
            lambda v, part=part: _solve(part, structure, parameters(v))[0],
            x, bounds=(bounds[:, 0], bounds[:, 1]), x_scale="jac", max_nfev=steps,
            ftol=1e-6, xtol=1e-6,
        ).x  # fmt: skip
    residual, coefficients = _solve(data, structure, parameters(x))
    cost = float(residual @ residual)
    return Modal(structure, parameters(x), coefficients, cost, data.mode_range_hz)


def columns(s: Complex, structure: Structure, parameters: Parameters) -> Complex:
    p = s[:, None] / parameters.omega
    one = 1.0 / (p * p + 2.0 * parameters.zeta * p + 1.0)
    lags = 1.0 / (1.0 + s[:, None] / parameters.corner)
    return np.hstack([one, p * one, lags] if structure.speed else [one, lags])


def _solve(data: Data, structure: Structure, parameters: Parameters) -> tuple[Array, Array]:
    """Return the weighted residual (2k + 1,) and the best coefficients.

    The last row holds a position's gain near that of the sensor.
    """
    s = np.asarray(2j * np.pi * data.hz)
    A = columns(s, structure, parameters)
    A = A * (data.weight * np.sinc(data.hz * TS) ** 2 * np.exp(-s * parameters.delay))[:, None]
    target = data.weight * data.H
    rows, wanted = np.vstack([A.real, A.imag]), np.append(target.real, target.imag)
    n, k = structure.modes, structure.lags
    at_rest = np.concatenate([np.ones(n), np.zeros(n * structure.speed), np.ones(k)])
    racks = structure.zeros_at_rest > 0
    gain, sd = data.sensor
    rows = np.vstack([rows, at_rest * (0.0 if racks else 1.0 / sd)])
    wanted = np.append(wanted, 0.0 if racks else gain / sd)
    if data.prior is not None:
        more, expected = data.prior.rows(structure, parameters)
        rows, wanted = np.vstack([rows, more]), np.append(wanted, expected)
    free = free_directions(structure, parameters, at_rest)
    reduced = rows @ free
    scale = np.maximum(np.sqrt(np.einsum("ij,ij->j", reduced, reduced)), 1e-300)
    x, *_ = linalg.lstsq(
        reduced / scale, wanted, cond=1e-9, lapack_driver="gelsy", check_finite=False
    )
    x = x / scale
    return np.asarray(wanted - reduced @ x), np.asarray(free @ x)


def free_directions(structure: Structure, parameters: Parameters, at_rest: Array) -> Array:
    """Return a basis of the coefficients that keep the zeros at rest.

    at_rest: the contribution of each coefficient to the response at rest.
    """
    if structure.zeros_at_rest == 0:
        return np.eye(len(at_rest))
    rows = [at_rest]
    if structure.zeros_at_rest == 2:  # the slope of the response over s vanishes, too
        unit = parameters.omega.min()
        speed = unit / parameters.omega
        lags = -unit / parameters.corner
        rows.append(np.concatenate([-2.0 * parameters.zeta * speed, speed, lags]))
    return np.asarray(linalg.null_space(np.array(rows)))
