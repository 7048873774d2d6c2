"""Bayesian linear regression with a kernel whose hyperparameters are those of greatest evidence.

    y = X θ + Ψ a + e,   e ~ N(0, I),   θ = (s, q),   s ~ N(0, S),   q ~ N(0, K_D),   a ~ N(0, a² I)

s are a few scalars, q the samples in which the response decays, and Ψ is what modes add, which may
ring for longer than q is. With P = Xᵀ X + diag(S⁻¹, K_D⁻¹) = L Lᵀ and the modes integrated last,

    −log p(y) = ½ log det K_D + log det L − ½ |L⁻¹Xᵀy|² + log det R − ½ |R⁻¹Ψᵀv|² + log det (aI) + …
    M = I − Zᵀ Z,   Z = L⁻¹ Xᵀ,   v = M y,   R Rᵀ = Ψᵀ M Ψ + I/a²

Z and v do not change with the modes, so that thousands of modes can be tried. They are added one at
a time, each where it gains most, as long as the evidence of the whole grows by LEAST_GAIN.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg, optimize

from hframe_post.arrays import TS, Array
from hframe_post.identification.estimation.kernel import Decay, Mode, ringing

AMPLITUDE = 30.0  # a, samples²: more than the q of any printer
FIRST = Decay(0.02, 0.04, 0.1)  # so little that modes are sought first
LEAST_GAIN = 8.0  # of log evidence, for a mode: four numbers
MOST_MODES = 4
TRIED_HZ = np.geomspace(12.0, 115.0, 60)
TRIED_OMEGA = 2.0 * np.pi * TS * TRIED_HZ[0] / 1.5, 2.0 * np.pi * TS * TRIED_HZ[-1] * 1.3
STEPS = 1e-3, 0.02  # of log ω and log ζ, that count alike
TRIED_DAMPING = (0.02, 0.05, 0.12, 0.3)
DAMPING = (0.01, 0.9)
CLOSEST = 0.03  # relative distance of two modes
LATEST = 8  # samples: onset of the modes at the latest
BETA, ALPHA = (1.5e-3, 0.2), (7e-3, 4.0)  # bounds of K_D's decay and roughness
ROUNDING = 1e-11  # of XᵀX; some hundred columns, of which low noise makes some nearly alike
WORST = 1e15  # cost of what cannot be computed


@dataclass(frozen=True, slots=True)
class Data:
    """Measured y (r,), by columns X (r, n + m) of scalars and of q at samples k (m,).

    All is divided by the standard deviation of the noise. precision (n,): S⁻¹ of the scalars.
    by_modes: gives Ψ (r, 2·modes) of modes and their onset.
    """

    X: Array
    y: Array
    k: Array
    precision: Array
    by_modes: Callable[[Sequence[Mode], int], Array]


@dataclass(frozen=True, slots=True)
class Prior:
    """All hyperparameters."""

    decay: Decay
    modes: tuple[Mode, ...] = ()
    onset: int = 1


@dataclass(frozen=True, slots=True)
class Posterior:
    """Mean and covariance of (s, q at samples k, amplitudes of modes). cost: −log evidence."""

    mean: Array
    covariance: Array
    k: Array
    prior: Prior
    cost: float

    def response(self, k: Array) -> Array:
        """Return the mean (l,) of decay and modes together, at samples k (l,)."""
        return np.asarray(self._columns(k) @ self.mean[self._scalars :])

    def known(self, k: Array) -> Array:
        """Return the covariance (l, l) of decay and modes together, at samples k (l,)."""
        columns = self._columns(k)
        return columns @ self.covariance[self._scalars :, self._scalars :] @ columns.T

    @property
    def _scalars(self) -> int:
        return len(self.mean) - len(self.k) - 2 * len(self.prior.modes)

    def _columns(self, k: Array) -> Array:
        return np.hstack([k[:, None] == self.k, ringing(k, self.prior.modes, self.prior.onset)])


def regress(data: Data, start: Prior | None = None, most: int = MOST_MODES) -> Posterior:
    """Return the posterior of greatest evidence.

    start: hyperparameters to begin with; by default modes are sought. most: number of modes.
    """
    search = _Search(data, start or Prior(FIRST))
    if start is None:
        search.add_modes(most)
    search.fit_decay()
    search.refine()
    if start is None:
        search.add_modes(most)
        search.fit_decay()
        search.refine()
        plain = _Search(data, Prior(replace(FIRST, c=1.0)))
        plain.fit_decay()
        search = min(search, plain, key=lambda one: one.cost())
    return search.posterior()


class _Search:
    """Hyperparameters on their way to greater evidence."""

    def __init__(self, data: Data, prior: Prior) -> None:
        self._data, self.prior = data, prior
        self._n = len(data.precision)
        self._A, self._b = _definite(data.X.T @ data.X), data.X.T @ data.y
        self._integrate()

    def _solved(self, decay: Decay) -> tuple[Array, Array, float]:
        """Return L, L⁻¹Xᵀy and −log evidence without modes."""
        P, log_det = self._precision(decay)
        L = linalg.cholesky(P, lower=True, overwrite_a=True, check_finite=False)
        z = linalg.solve_triangular(L, self._b, lower=True, check_finite=False)
        return L, z, float(0.5 * log_det + np.log(np.diag(L)).sum() - 0.5 * z @ z)

    def _precision(self, decay: Decay) -> tuple[Array, float]:
        """Return P and log det K_D."""
        inverse, log_det = decay.precision(self._data.k)
        P = self._A.copy()
        P[self._n :, self._n :] += inverse
        P[np.arange(self._n), np.arange(self._n)] += self._data.precision
        return P, log_det

    def _integrate(self) -> None:
        L, z, self._without = self._solved(self.prior.decay)
        self._Z = linalg.solve_triangular(L, self._data.X.T, lower=True, check_finite=False)
        self._v = self._data.y - self._Z.T @ z

    def _by_modes(self, modes: Sequence[Mode], onset: int) -> float:
        """Return by how much modes change −log evidence."""
        return _integrated(*self._seen(modes, onset))

    def _seen(self, modes: Sequence[Mode], onset: int) -> tuple[Array, Array]:
        """Return Ψᵀ M Ψ and Ψᵀ v."""
        Psi = self._data.by_modes(modes, onset)
        decaying = self._Z @ Psi
        return Psi.T @ Psi - decaying.T @ decaying, Psi.T @ self._v

    def cost(self) -> float:
        return self._without + self._by_modes(self.prior.modes, self.prior.onset)

    def add_modes(self, most: int) -> None:
        """Add modes while each makes the measurement likelier than chance."""
        tried = tuple(Mode(2.0 * np.pi * TS * hz, z) for hz in TRIED_HZ for z in TRIED_DAMPING)
        while len(self.prior.modes) < most:
            before, now = self.prior, self.cost()
            self.prior = replace(before, modes=(*before.modes, self._likeliest(tried)))
            self.refine()
            if self.cost() > now - LEAST_GAIN:
                self.prior = before
                return

    def _likeliest(self, tried: Sequence[Mode]) -> Mode:
        """Return the mode that adds most to those that there are."""
        modes, onset = self.prior.modes, self.prior.onset
        M, v = self._seen((*modes, *tried), onset)
        before = np.arange(2 * len(modes))

        def cost(j: int) -> float:
            own = np.concatenate([before, len(before) + 2 * j + np.arange(2)])
            return _integrated(M[np.ix_(own, own)], v[own])

        apart = [j for j, one in enumerate(tried) if _apart((*modes, one))]
        return tried[min(apart, key=cost)]

    def refine(self) -> None:
        """Move the modes and their onset to greater evidence."""
        if not self.prior.modes:
            return
        start = np.log([[mode.omega, mode.zeta] for mode in self.prior.modes]).ravel()
        steps = np.tile(STEPS, len(self.prior.modes))
        bounds = np.log([TRIED_OMEGA, DAMPING] * len(self.prior.modes))

        def modes(x: Array) -> tuple[Mode, ...]:
            return tuple(Mode(float(w), float(z)) for w, z in np.exp(x).reshape(-1, 2))

        def cost(steps_away: Array) -> float:
            return self._by_modes(modes(start + steps * steps_away), self.prior.onset)

        found = optimize.minimize(
            cost, np.zeros(len(start)), method="L-BFGS-B", options={"maxiter": 30, "ftol": 1e-7},
            bounds=(bounds - start[:, None]) / steps[:, None],
        )  # fmt: skip
        x = start + steps * found.x
        if not _apart(modes(x)):
            return
        onset = min(range(LATEST), key=lambda d: self._by_modes(modes(x), d))
        self.prior = replace(self.prior, modes=modes(x), onset=onset)

    def fit_decay(self) -> None:
        """Move K_D to greater evidence."""
        data = self._data
        Psi = data.by_modes(self.prior.modes, self.prior.onset)
        X_Psi, Psi_Psi, y_Psi = data.X.T @ Psi, Psi.T @ Psi, Psi.T @ data.y

        def decay(x: Array) -> Decay:
            c, beta, alpha = np.exp(x)
            return Decay(float(c), float(np.clip(beta, *BETA)), float(np.clip(alpha, *ALPHA)))

        def cost(x: Array) -> float:
            try:
                L, z, without = self._solved(decay(x))
            except linalg.LinAlgError:
                return WORST
            X = linalg.solve_triangular(L, X_Psi, lower=True, check_finite=False)
            return without + _integrated(Psi_Psi - X.T @ X, y_Psi - X.T @ z)

        now = self.prior.decay
        start = np.log([now.c, now.beta, now.alpha])
        x = _minimised(cost, start, np.array([1.5, 0.6, 0.6]), 45, (0.05, 0.3))
        self.prior = replace(self.prior, decay=decay(x))
        self._integrate()

    def posterior(self) -> Posterior:
        """Return the posterior."""
        Psi = self._data.by_modes(self.prior.modes, self.prior.onset)
        X_Psi = self._data.X.T @ Psi
        of_modes = _definite(Psi.T @ Psi) + np.eye(Psi.shape[1]) / AMPLITUDE**2
        P, _ = self._precision(self.prior.decay)
        whole = linalg.cho_factor(np.block([[P, X_Psi], [X_Psi.T, of_modes]]), lower=True)
        covariance = linalg.cho_solve(whole, np.eye(len(whole[0])))
        mean = linalg.cho_solve(whole, np.concatenate([self._b, Psi.T @ self._data.y]))
        return Posterior(mean, covariance, self._data.k, self.prior, self.cost())


def _definite(A: Array) -> Array:
    """Return A, to which so little was added that rounding leaves it positive definite."""
    return A + np.diag(ROUNDING * A.diagonal())


def _apart(modes: Sequence[Mode]) -> bool:
    omega = np.log(sorted(mode.omega for mode in modes))
    return bool((np.diff(omega) > CLOSEST).all())


def _integrated(M: Array, v: Array) -> float:
    """Return what the amplitudes of modes add to −log evidence, M (2n, 2n) and v (2n,)."""
    try:
        R = linalg.cholesky(M + np.eye(len(M)) / AMPLITUDE**2, lower=True, check_finite=False)
    except linalg.LinAlgError:
        return WORST
    if not len(v):
        return 0.0
    z = linalg.solve_triangular(R, v, lower=True, check_finite=False)
    cost = np.log(np.diag(R)).sum() + len(v) * np.log(AMPLITUDE) - 0.5 * z @ z
    return float(cost) if np.isfinite(cost) else WORST


def _minimised(
    cost: object, start: Array, steps: Array, most: int, tolerance: tuple[float, float]
) -> Array:
    simplex = np.vstack([start, start + np.diag(steps)])
    options = {"initial_simplex": simplex, "maxfev": most, "xatol": tolerance[0],
               "fatol": tolerance[1]}  # fmt: skip
    return np.asarray(optimize.minimize(cost, start, method="Nelder-Mead", options=options).x)
