"""What is known of an impulse response q before it is measured.

    q ~ N(0, K),   K = K_D + K_M
    K_D(j, k) = c² e^{−β(|j| + |k|)} e^{−α|j − k|}        it decays, and neighbours are alike
    K_M       = a² Σ_i Φ_i Φ_iᵀ,                          it rings in a few modes
    Φ_i(k)    = e^{−ζω_i(k−d)} [cos ω'_i(k−d), sin ω'_i(k−d)] / norm,  k ≥ d

K_D is the DC kernel, and K_M one of rank two a mode (Pillonetto, Chen, Chiuso, De Nicolao, Ljung,
Regularized System Identification, Springer 2022, ch. 5). A printer that is a sum of modes needs no
K_D, one without clear modes no K_M. c, β, α, the modes and d are hyperparameters.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hframe_post.arrays import TS, Array, Complex

LEAST_LOG_SD = -60.0  # below which a standard deviation could not be inverted


@dataclass(frozen=True, slots=True)
class Decay:
    """Hyperparameters of K_D: size c, and per sample the decay β and the roughness α."""

    c: float
    beta: float
    alpha: float

    def precision(self, k: Array) -> tuple[Array, float]:
        """Return K_D⁻¹ (m, m) and log det K_D at consecutive samples k (m,).

        The sequence is a Markov chain, so the inverse is tridiagonal.
        """
        m, rho = len(k), np.exp(-self.alpha)
        fresh = -np.expm1(-2.0 * self.alpha)  # 1 − ρ²
        log_sd = np.maximum(np.log(self.c) - self.beta * np.abs(k), LEAST_LOG_SD)
        inner = np.full(m, (1.0 + rho * rho) / fresh)
        inner[[0, -1]] = 1.0 / fresh
        inverse = np.diag(inner)
        at = np.arange(m - 1)
        inverse[at, at + 1] = inverse[at + 1, at] = -rho / fresh
        sd = np.exp(log_sd)
        return inverse / np.outer(sd, sd), float(2.0 * log_sd.sum() + (m - 1) * np.log(fresh))


@dataclass(frozen=True, slots=True)
class Mode:
    """A mode: its frequency in rad/sample and its damping ratio."""

    omega: float
    zeta: float

    @property
    def hz(self) -> float:
        return self.omega / (2.0 * np.pi * TS)

    @property
    def pole(self) -> complex:
        """Pole, per sample: −ζω + iω'."""
        return complex(-self.zeta * self.omega, self.omega * np.sqrt(1.0 - self.zeta**2))

    @property
    def norms(self) -> Array:
        """Norms of cosine and sine, over all time."""
        alike = 1.0 / -np.expm1(2.0 * self.pole.real)
        apart = (1.0 / -np.expm1(2.0 * self.pole)).real
        return np.sqrt(np.maximum([alike + apart, alike - apart], 1e-18) / 2.0)


@dataclass(frozen=True, slots=True)
class Prior:
    """All hyperparameters."""

    decay: Decay
    modes: tuple[Mode, ...] = ()
    onset: int = 1


def ringing(k: Array, modes: Sequence[Mode], onset: int) -> Array:
    """Return Φ (m, 2·modes), every column with a norm of 1 over all time, at samples k (m,)."""
    after = k >= onset
    t = np.where(after, k - onset, 0.0)
    columns = []
    for mode in modes:
        turning = np.where(after, np.exp(mode.pole * t), 0.0)
        columns += list(np.array([turning.real, turning.imag]) / mode.norms[:, None])
    return np.column_stack(columns) if columns else np.zeros((len(k), 0))


def transfer(z: Complex, modes: Sequence[Mode], onset: int) -> Complex:
    """Return Φ as transfer functions of z (k,), k × 2·modes."""
    columns = []
    for mode in modes:
        turning = z**-onset / (1.0 - np.exp(mode.pole) / z)
        back = z**-onset / (1.0 - np.exp(np.conj(mode.pole)) / z)
        columns += [(turning + back) / (2.0 * mode.norms[0]),
                    (turning - back) / (2j * mode.norms[1])]  # fmt: skip
    return np.column_stack(columns) if columns else np.zeros((len(z), 0), dtype=complex)
