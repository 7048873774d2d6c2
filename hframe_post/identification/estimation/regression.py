"""Bayesian linear regression with a kernel whose hyperparameters are those of greatest evidence.

What is known of an impulse response q before it is measured:

    q ~ N(0, K),   K = K_D + K_M
    K_D(j, k) = c² e^{−β(|j| + |k|)} e^{−α|j − k|}        it decays, and neighbours are alike
    K_M       = a² Σ_i Φ_i Φ_iᵀ,                          it rings in a few modes
    Φ_i(k)    = e^{−ζω_i(k−1)} [cos ω'_i(k−1), sin ω'_i(k−1)] / norm,  k ≥ 1

K_D is the DC kernel, and K_M one of rank two a mode (Pillonetto, Chen, Chiuso, De Nicolao, Ljung,
Regularized System Identification, Springer 2022, ch. 5). A printer that is a sum of modes needs no
K_D, one without clear modes no K_M. c, β, α and the modes are hyperparameters. Measured is

    y = X θ + Ψ a + e,   e ~ N(0, I),   θ = (s, q),   s ~ N(0, S),   q ~ N(0, K_D),   a ~ N(0, a² I)

s are a few scalars, q the samples in which the response decays, and Ψ is what modes add, which may
ring for longer than q is. With W = [X Ψ], Π = diag(S, K_D, a² I), P = Wᵀ W + Π⁻¹ = L Lᵀ and the
mean θ̂ = P⁻¹ Wᵀ y,

    −log p(y) = ½ log det Π + log det L + ½ |y − W θ̂|² + ½ θ̂ᵀ Π⁻¹ θ̂ + …

Modes are added one at a time, each where it gains most, as long as the evidence of the whole grows
by LEAST_GAIN. Thousands are tried, so they are integrated last: with P of X alone,

    −log p(y) = … + log det R − ½ |R⁻¹Ψᵀv|² + log det (aI)
    M = I − Zᵀ Z,   Z = L⁻¹ Xᵀ,   v = M y,   R Rᵀ = Ψᵀ M Ψ + I/a²

where M and v do not change with the modes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import astuple, dataclass, replace

import numpy as np
from scipy import linalg, optimize

from hframe_post.arrays import TS, Array, Complex


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
        log_sd = np.log(self.c) - self.beta * np.abs(k)
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


@dataclass(frozen=True, slots=True)
class Prior:
    """All hyperparameters."""

    decay: Decay
    modes: tuple[Mode, ...] = ()


def _poles(modes: Sequence[Mode]) -> tuple[Complex, Array]:
    """Return the poles of modes, −ζω + iω' per sample, and the norms of their Φ over all time."""
    omega, zeta = np.array([(mode.omega, mode.zeta) for mode in modes]).reshape(-1, 2).T
    return omega * (1j * np.sqrt(1.0 - zeta**2) - zeta), (
        -2.0 * np.expm1(-2.0 * zeta * omega)
    ) ** -0.5


def ringing(k: Array, modes: Sequence[Mode]) -> Array:
    """Return Φ (m, 2·modes), every column with a norm of 1 over all time, at samples k (m,)."""
    poles, norms = _poles(modes)
    t = k[:, None] - 1.0
    turning = np.where(t >= 0.0, np.exp(poles * np.maximum(t, 0.0)), 0.0) / norms
    return np.stack([turning.real, turning.imag], axis=2).reshape(len(k), -1)


def transfer(z: Complex, modes: Sequence[Mode]) -> Complex:
    """Return Φ as transfer functions of z (k,), k × 2·modes."""
    poles, norms = _poles(modes)
    z = z[:, None]
    turning, back = (1.0 / (z - np.exp(each)) / norms for each in (poles, poles.conj()))
    both = np.stack([(turning + back) / 2.0, (turning - back) / 2j], axis=2)
    return both.reshape(len(z), -1)


AMPLITUDE = 30.0  # a, samples²: more than the q of any printer
FIRST = Decay(0.02, 0.04, 0.1)  # so little that modes are sought first
LEAST_GAIN = 8.0  # of log evidence, for a mode: four numbers
MOST_MODES = 4
OMEGA = 2.0 * np.pi * TS * 8.0, 2.0 * np.pi * TS * 150.0  # of modes
STEPS = 1e-3, 0.02  # of log ω and log ζ, that count alike
DAMPING = (0.01, 0.9)
TRIED = tuple(
    Mode(2.0 * np.pi * TS * hz, zeta)
    for hz in np.geomspace(12.0, 115.0, 60) for zeta in (0.02, 0.05, 0.12, 0.3)
)  # fmt: skip
LEAST, MOST = Decay(1e-6, 1.5e-3, 7e-3), Decay(30.0, 0.2, 4.0)  # bounds of K_D


NO_SCALARS = np.zeros(0)


def no_modes(modes: Sequence[Mode]) -> Array:
    raise ValueError("these data have no modes")


def rows(weight: Array, columns: Array | Complex) -> Array:
    """Return weighted columns (k, …) as real and imaginary rows, (2k, …)."""
    weighted = (weight * columns.T).T
    return np.concatenate([weighted.real, weighted.imag])


@dataclass(frozen=True, slots=True)
class Data:
    """Measured y (r,), by columns X (r, n + m) of scalars and of q at samples k (m,).

    All is divided by the standard deviation of the noise. precision (n,): S⁻¹ of the scalars.
    by_modes: gives Ψ (r, 2·modes) of modes. X_X, X_y: XᵀX and Xᵀy.
    """

    X: Array
    y: Array
    k: Array
    precision: Array
    by_modes: Callable[[Sequence[Mode]], Array]
    X_X: Array
    X_y: Array

    @classmethod
    def of(
        cls, X: Array, y: Array, k: Array, precision: Array = NO_SCALARS,
        by_modes: Callable[[Sequence[Mode]], Array] = no_modes,
    ) -> Data:  # fmt: skip
        return cls(X, y, k, precision, by_modes, X.T @ X, X.T @ y)


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
        columns = self._columns(k)
        return np.asarray(columns @ self.mean[-columns.shape[1] :])

    def known(self, k: Array) -> Array:
        """Return the covariance (l, l) of decay and modes together, at samples k (l,)."""
        columns = self._columns(k)
        own = slice(-columns.shape[1], None)
        return columns @ self.covariance[own, own] @ columns.T

    def _columns(self, k: Array) -> Array:
        modes = ringing(k, self.prior.modes)
        return np.column_stack([k[:, None] == self.k, modes])


def regress(data: Data, start: Prior | None = None) -> Posterior:
    """Return the posterior of greatest evidence.

    start: hyperparameters to begin with; without them modes are sought.
    """
    search = _Search(data, start or Prior(FIRST))
    if start is None:
        search.add_modes()
    search.fit_decay()
    search.refine()
    search.drop_modes()
    return posterior(data, search.prior)


def posterior(data: Data, prior: Prior) -> Posterior:
    """Return the posterior for given hyperparameters."""
    L, mean, cost = _Normal.with_modes(data, prior).solved(prior.decay)
    covariance = linalg.cho_solve((L, True), np.eye(len(L)), check_finite=False)
    return Posterior(mean, covariance, data.k, prior, cost)


class _Search:
    """Hyperparameters on their way to greater evidence."""

    def __init__(self, data: Data, prior: Prior) -> None:
        self._data, self.prior = data, prior
        self._without_modes = _Normal.of(data, data.X[:, :0])
        self._integrate()

    def _integrate(self) -> None:
        """Integrate over s and q, for the modes that will be tried."""
        L, mean, _ = self._without_modes.solved(self.prior.decay)
        self._Z = linalg.solve_triangular(L, self._data.X.T, lower=True, check_finite=False)
        self._v = self._data.y - self._data.X @ mean

    def _costs(self, tried: Sequence[Mode], choices: Sequence[Sequence[int]]) -> list[float]:
        """Return by how much each choice of the tried modes changes −log evidence."""
        M, v = self._seen(tried)
        columns = [
            np.array([[2 * j, 2 * j + 1] for j in chosen], int).ravel() for chosen in choices
        ]
        return [_integrated(M[np.ix_(own, own)], v[own]) for own in columns]

    def _seen(self, modes: Sequence[Mode]) -> tuple[Array, Array]:
        """Return Ψᵀ M Ψ and Ψᵀ v."""
        Psi = self._data.by_modes(modes)
        decaying = self._Z @ Psi
        return _safe(Psi.T @ Psi) - decaying.T @ decaying, Psi.T @ self._v

    def _normal(self) -> _Normal:
        return _Normal.with_modes(self._data, self.prior)

    def cost(self) -> float:
        return self._normal().solved(self.prior.decay)[2]

    def add_modes(self) -> None:
        """Add modes while each makes the measurement likelier than chance."""
        while len(self.prior.modes) < MOST_MODES:
            before, now = self.prior, self.cost()
            self.prior = replace(before, modes=(*before.modes, self._likeliest(TRIED)))
            self.refine()
            if self.cost() > now - LEAST_GAIN:
                self.prior = before
                break

    def drop_modes(self) -> None:
        """Drop modes without which the measurement is likelier."""
        for mode in self.prior.modes:
            before, now = self.prior, self.cost()
            self.prior = replace(before, modes=tuple(one for one in before.modes if one != mode))
            if self.cost() > now:
                self.prior = before

    def _likeliest(self, tried: Sequence[Mode]) -> Mode:
        """Return the mode that adds most to those that there are."""
        modes = self.prior.modes
        apart = [one for one in tried if _apart((*modes, one))]
        choices = [(*range(len(modes)), len(modes) + j) for j in range(len(apart))]
        costs = self._costs((*modes, *apart), choices)
        return apart[int(np.argmin(costs))]

    def refine(self) -> None:
        """Move the modes to greater evidence."""
        if not self.prior.modes:
            return
        start = np.log([[mode.omega, mode.zeta] for mode in self.prior.modes]).ravel()
        n, steps, slightly = len(start), np.tile(STEPS, len(self.prior.modes)), 1e-4
        bounds = np.log([OMEGA, DAMPING] * len(self.prior.modes))

        def modes(steps_away: Array) -> tuple[Mode, ...]:
            x = np.exp(start + steps * steps_away)
            return tuple(Mode(float(w), float(z)) for w, z in x.reshape(-1, 2))

        def cost(x: Array) -> tuple[float, Array]:
            """Return the cost and its slope. One product with Z serves all differences."""
            moved = [modes(each)[j // 2] for j, each in enumerate(x + slightly * np.eye(n))]
            usual = range(n // 2)
            instead = [[n // 2 + j if k == j // 2 else k for k in usual] for j in range(n)]
            here, *there = self._costs((*modes(x), *moved), [usual, *instead])
            return here, (np.array(there) - here) / slightly

        found = optimize.minimize(
            cost, np.zeros(n), jac=True, method="L-BFGS-B", options={"maxiter": 30, "ftol": 1e-7},
            bounds=(bounds - start[:, None]) / steps[:, None],
        ).x  # fmt: skip
        if _apart(modes(found)):
            self.prior = replace(self.prior, modes=modes(found))

    def fit_decay(self) -> None:
        """Move K_D to greater evidence."""
        normal = self._normal()

        def decay(x: Array) -> Decay:
            c, beta, alpha = np.clip(np.exp(x), astuple(LEAST), astuple(MOST)).tolist()
            return Decay(c, beta, alpha)

        def cost(x: Array) -> float:
            return normal.solved(decay(x))[2]

        start = np.log(astuple(self.prior.decay))
        simplex = np.vstack([start, start + np.diag([1.5, 0.6, 0.6])])
        options = {"initial_simplex": simplex, "maxfev": 45, "xatol": 0.05, "fatol": 0.3}
        found = optimize.minimize(cost, start, method="Nelder-Mead", options=options)
        self.prior = replace(self.prior, decay=decay(found.x))
        self._integrate()


@dataclass(frozen=True, slots=True)
class _Normal:
    """The normal equations A θ = b of (s, q, a), and yᵀy, without what is expected of θ.

    k (m,): samples of q. precision (n,): S⁻¹.
    """

    A: Array
    b: Array
    y_y: float
    k: Array
    precision: Array

    @classmethod
    def with_modes(cls, data: Data, prior: Prior) -> _Normal:
        return cls.of(data, data.by_modes(prior.modes) if prior.modes else data.X[:, :0])

    @classmethod
    def of(cls, data: Data, Psi: Array) -> _Normal:
        X_Psi = data.X.T @ Psi
        A = _safe(np.block([[data.X_X, X_Psi], [X_Psi.T, Psi.T @ Psi]]))
        b = np.concatenate([data.X_y, Psi.T @ data.y])
        return cls(A, b, float(data.y @ data.y), data.k, data.precision)

    def solved(self, decay: Decay) -> tuple[Array, Array, float]:
        """Return L of P = L Lᵀ, the mean of θ, and −log evidence.

        The evidence is that of this very mean. Rounding can then only lower it, while the same by
        L alone grows beyond all bounds where P is nearly singular.
        """
        inverse, log_det = decay.precision(self.k)
        P, n, q = self.A.copy(), len(self.precision), len(self.precision) + len(self.k)
        P[n:q, n:q] += inverse
        diagonal = P.reshape(-1)[:: len(P) + 1]
        diagonal[:n] += self.precision
        diagonal[q:] += AMPLITUDE**-2.0
        L = linalg.cholesky(P, lower=True, check_finite=False)
        mean = linalg.cho_solve((L, True), self.b, check_finite=False)
        left = self.y_y - 2.0 * float(self.b @ mean) + float(mean @ P @ mean)
        integrated = np.log(np.diag(L)).sum() - 0.5 * np.log(self.precision).sum()
        integrated += (len(P) - q) * np.log(AMPLITUDE)
        return L, mean, float(0.5 * (log_det + left) + integrated)


def _safe(A: Array) -> Array:
    """Return A (n, n), which rounding leaves positive definite even where columns are alike."""
    A[np.diag_indices_from(A)] *= 1.0 + 1e-11
    return A


def _apart(modes: Sequence[Mode]) -> bool:
    """Return whether the frequencies of modes differ by 3 % or more."""
    omega = np.log(sorted(mode.omega for mode in modes))
    return bool((np.diff(omega) > 0.03).all())


def _integrated(M: Array, v: Array) -> float:
    """Return what the amplitudes of modes add to −log evidence, M (2n, 2n) and v (2n,)."""
    R = linalg.cholesky(M + np.eye(len(M)) / AMPLITUDE**2, lower=True, check_finite=False)
    if not len(v):
        return 0.0
    z = linalg.solve_triangular(R, v, lower=True, check_finite=False)
    return float(np.log(np.diag(R)).sum() + len(v) * np.log(AMPLITUDE) - 0.5 * z @ z)
