"""A sum of modes behind a delay: what people read, and when motion begins.

    H(f) = g·e^{−sτ}·sinc²(f·Ts)·Σ (c_i + d_i p_i) / (p_i² + 2ζ_i p_i + 1),   Σ c_i = 1
    p_i = s/ω_i,  s = 2πjf

=============  ==========================================================================
``ω_i, ζ_i``   natural frequency and damping ratio of a mode
``c_i, d_i``   its contribution to the motion, by position and by speed
``g, τ``       gain, and delay of printer and recording together
=============  ==========================================================================

sinc² stands for the command, played as straight lines between samples of Ts. For given ω_i, ζ_i and
τ the rest is a linear problem, solved exactly in each step (variable projection).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg, optimize

from hframe_post.arrays import TS, Array, Complex
from hframe_post.identification.estimation.frequency_response import FrequencyResponse, weights
from hframe_post.identification.estimation.regression import Mode

DAMPING = (0.004, 0.95)  # bounds of a mode's damping ratio
ABOVE = 1.3  # times what was measured, up to which modes may lie
FREQUENCIES = 250  # that are enough
COMPANION = 0.06  # relative distance below which two modes are described as one
STEPS = 40  # of the search


@dataclass(frozen=True, slots=True)
class Modes:
    """A sum of modes: omega (n,) in rad/sample, zeta, c and d (n,), the gain g, the delay τ, s."""

    omega: Array
    zeta: Array
    c: Array
    d: Array
    gain: float
    delay: float

    @property
    def sizes(self) -> Array:
        """Return the contribution of each mode to the motion, (n,)."""
        return np.hypot(self.c, self.d)

    @property
    def hz(self) -> Array:
        """Return the natural frequencies, (n,)."""
        return self.omega / (2.0 * np.pi * TS)

    def response(self, hz: Array) -> Complex:
        """Return H at ``hz`` (k,), with gain and delay."""
        s = np.asarray(2j * np.pi * TS * hz)
        played = self.gain * np.sinc(hz * TS) ** 2 * np.exp(-s * self.delay / TS)
        columns = _columns(s, self.omega, self.zeta, speed=True)
        return np.asarray(played * (columns @ np.concatenate([self.c, self.d])))


def described(
    measured: FrequencyResponse,
    start: Sequence[Mode],
    delays: tuple[float, float],
    gain: tuple[float, float],
    speed: bool,
) -> Modes:
    """Return the modes nearest to a measured response.

    start: those to begin with, of which companions are left out. delays: bounds, s. gain: mean and
    standard deviation. speed: whether d is free; if it is not, all that is late, but for the delay,
    is so by damping.
    """
    every = slice(None, None, max(1, len(measured.hz) // FREQUENCIES))
    hz, H, weight = measured.hz[every], measured.H[every], weights(measured)[every]
    apart: list[Mode] = []
    for mode in start:
        if all(abs(np.log(mode.omega / kept.omega)) > COMPANION for kept in apart):
            apart.append(mode)
    return _nearest(hz, H, weight, apart, delays, gain, speed)


def _nearest(
    hz: Array, H: Complex, weight: Array, start: Sequence[Mode], delays: tuple[float, float],
    gain: tuple[float, float], speed: bool,
) -> Modes:  # fmt: skip
    n, s = len(start), np.asarray(2j * np.pi * TS * hz)
    played, target = weight * np.sinc(hz * TS) ** 2, weight * H
    wanted = np.concatenate([target.real, target.imag, [gain[0] / gain[1]]])
    at_rest = np.concatenate([np.ones(n), np.zeros(n * speed)]) / gain[1]

    def solved(x: Array) -> tuple[Array, Array]:
        """Return the residual, and c and d times the gain."""
        A = _columns(s, np.exp(x[:n]), np.exp(x[n:-1]), speed)
        A = A * (played * np.exp(-s * x[-1]))[:, None]
        rows = np.vstack([A.real, A.imag, at_rest])
        scale = np.sqrt(np.einsum("ij,ij->j", rows, rows))
        x, *_ = linalg.lstsq(
            rows / scale, wanted, cond=1e-9, lapack_driver="gelsy", check_finite=False
        )
        return wanted - (rows / scale) @ x, x / scale

    bounds = np.array([
        *[np.log(2.0 * np.pi * TS * np.array([0.5 * hz[0], ABOVE * hz[-1]]))] * n,
        *[np.log(DAMPING)] * n, np.array(delays) / TS,
    ])  # fmt: skip
    x = np.log([one.omega for one in start] + [one.zeta for one in start])
    room = 1e-3 * (bounds[:, 1] - bounds[:, 0])
    x = np.append(x, sum(delays) / (2.0 * TS))
    x = np.clip(x, bounds[:, 0] + room, bounds[:, 1] - room)
    x = optimize.least_squares(
        lambda x: solved(x)[0], x, bounds=(bounds[:, 0], bounds[:, 1]), x_scale="jac",
        max_nfev=STEPS, ftol=1e-6, xtol=1e-6,
    ).x  # fmt: skip
    _, scaled = solved(x)
    g = float(scaled[:n].sum())
    c, d = scaled[:n] / g, (scaled[n:] / g if speed else np.zeros(n))
    return Modes(np.exp(x[:n]), np.exp(x[n:-1]), c, d, g, float(x[-1]) * TS)


def _columns(s: Complex, omega: Array, zeta: Array, speed: bool) -> Complex:
    p = s[:, None] / omega
    one = 1.0 / (p * p + 2.0 * zeta * p + 1.0)
    return np.hstack([one, p * one]) if speed else one
