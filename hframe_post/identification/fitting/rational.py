"""A rational discrete transfer function from a measured frequency response.

Model: H(f) = g·G(e^{jω·TS}) e^{−jωτ}, G(1) exactly 0 or 1. A position (1) has relative degree one
or more, and g is the sensor's gain; racking (0) may respond in the same sample, as the paper's
does, and g is 1.

1. Start: Sanathanan–Koerner iteration as relocation of poles (`kautz.Denominator`), for
   several delays within the bounds.
2. scipy.optimize.least_squares on the sections of the denominator and τ. For given poles and
   delay the zeros are a linear problem, so each step solves it exactly (variable
   projection): the minimum is that on poles, zeros and delay together, with fewer unknowns.
3. The order with the least BIC; a lower one that is as good within CLOSE wins. Then step 2
   again with all frequencies.

Poles are searched by natural frequency and damping: none slower than half of the band's low
end, none that rings above its high end. Each frequency counts with the noise that its coherence
tells, and no noise below FLOOR is believed. Above the band, where nothing is known, G is held
loosely below its peak.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy import linalg, optimize

from hframe_post.arrays import TS, Array, Complex
from hframe_post.errors import IdentificationError
from hframe_post.identification.fitting.kautz import Denominator, denominator, transfer_function
from hframe_post.identification.fitting.weighting import INSIDE, SENSOR, weights
from hframe_post.identification.responses.frequency_response import FrequencyResponse
from hframe_post.model.transfer_function import TransferFunction

RADIUS = 0.999  # largest pole modulus of a start
STARTED = 200  # frequencies, of those measured, for the starts
TRIED = 400  # and to choose the order; all of them for the result
ROUNDS = 10  # of relocation, from each start
DELAY_STEP = 1e-3  # s between starts
GOOD = 0.1  # residual, in units of the noise, below which no better one is wanted
CLOSE = 10.0  # of BIC: very strong evidence (Kass and Raftery 1995)
LOOSE = 1.0  # |G| above the band, of the largest |H|: one standard deviation
FASTEST = 3.0  # decay per sample of a pole that does not ring
DAMPING = (0.004, 0.9999)  # of one that does
NEAR = 4.0  # of the best start's cost, up to which the second is refined too
PATIENCE = 2  # orders without a better score, after which higher ones are not tried


@dataclass(frozen=True, slots=True)
class Rational:
    """A transfer function G, the gain g of the sensor and a delay (s), as they were fitted.

    cost: of the weighted residual; scores: BIC by order.
    """

    G: TransferFunction
    gain: float
    delay: float
    cost: float
    scores: dict[int, float]

    def response(self, hz: Array) -> Complex:
        """H at ``hz`` (k,), with gain and delay."""
        omega = 2.0 * np.pi * hz
        played = self.G.response(omega * TS) * np.exp(-1j * omega * self.delay)
        return np.asarray(self.gain * played)


@dataclass(frozen=True)
class _Data:
    """What is fitted: weights (k,) are one over the standard deviation of H; ``held`` is z
    above the band, ``loosely`` its weight."""

    omega: Array
    z: Complex
    H: Complex
    weight: Array
    at_rest: float
    gain: tuple[float, float]
    delay_bounds: tuple[float, float]
    held: Complex
    loosely: float
    slowest: float  # rad per sample, of a pole
    fastest: float  # the same, of one that rings

    @property
    def direct(self) -> bool:
        """Whether the response may begin in the same sample."""
        return self.at_rest == 0.0


@dataclass(frozen=True, slots=True)
class _Trial:
    """Poles and delay (s) that were tried, with the best zeros: coefficients ``c`` and cost."""

    den: Denominator
    delay: float
    c: Array
    cost: float

    @classmethod
    def of(cls, data: _Data, den: Denominator, delay: float) -> _Trial:
        """The trial of these poles and this delay."""
        r, c = _solve(data, den, delay)
        return cls(den, delay, c, float(r @ r))


def fit(
    response: FrequencyResponse,
    order: int | None,
    at_rest: float,
    band_hz: tuple[float, float],
    delay_bounds_s: tuple[float, float] = (0.0, 0.0),
    max_order: int = 10,
    sensor: tuple[float, float] = SENSOR,
) -> Rational:
    """The transfer function of ``order`` poles, or of the order that the data support.

    at_rest: G(1), 1 for a position, 0 for racking. sensor: its gain as expected, mean and
    standard deviation. Raises IdentificationError where the band
    holds too little to fit, ValueError for impossible arguments.
    """
    low, high = delay_bounds_s
    if at_rest not in (0.0, 1.0) or not low <= high:
        raise ValueError("at_rest must be 0 or 1 and the delay's bounds ascend")
    if order is not None and order < 1:
        raise IdentificationError(f"order {order} is too low; 1 is the least")
    part = response.within(band_hz)
    data = _data(part, at_rest, band_hz, delay_bounds_s, sensor)
    top = max_order if order is None else order
    if len(data.z) < 2 * top + 2:
        raise IdentificationError(
            f"{len(data.z)} frequencies in {band_hz[0]:g}–{band_hz[1]:g} Hz are too few "
            f"for order {top}"
        )
    orders = range(1, max_order + 1) if order is None else [order]
    trials, scores = _tried(_thinned(data, TRIED), orders)
    best = _refined(data, trials[_chosen(scores)], 100)
    gain = float(best.den.basis(np.ones(1, complex))[0].real @ best.c) if at_rest else 1.0
    G = transfer_function(best.den, best.c / gain, at_rest, data.z)
    return Rational(G, gain, best.delay, best.cost, scores)


def _tried(data: _Data, orders: Iterable[int]) -> tuple[dict[int, _Trial], dict[int, float]]:
    """Trials and scores by order, ascending, until PATIENCE orders were no better."""
    trials: dict[int, _Trial] = {}
    scores: dict[int, float] = {}
    for n in orders:
        if trials and n - _chosen(scores) > PATIENCE:
            break
        trials[n] = _best(data, n)
        scores[n] = _bic(data, trials[n])
    return trials, scores


def _chosen(scores: dict[int, float]) -> int:
    return min(n for n in scores if scores[n] <= min(scores.values()) + CLOSE)


def _data(
    part: FrequencyResponse,
    at_rest: float,
    band_hz: tuple[float, float],
    bounds: tuple[float, float],
    gain: tuple[float, float],
) -> _Data:
    weight = weights(part)
    largest = float(np.abs(part.H).max())
    omega = 2.0 * np.pi * part.hz
    top = 1.5 * part.hz.max()
    held = np.exp(2j * np.pi * TS * np.linspace(top, 0.5 / TS, 8)) if top < 0.4 / TS else None
    return _Data(
        omega,
        np.exp(1j * omega * TS),
        part.H,
        weight,
        at_rest,
        gain,
        bounds,
        np.zeros(0, complex) if held is None else held,
        1.0 / (LOOSE * largest),
        2.0 * np.pi * INSIDE * band_hz[0] * TS,
        2.0 * np.pi * band_hz[1] * TS,
    )


def _best(data: _Data, order: int) -> _Trial:
    """The best trial of an order: the best start, refined."""
    low, high = data.delay_bounds
    delays = np.linspace(low, high, 1 + int(np.ceil((high - low) / DELAY_STEP)))
    coarse = _thinned(data, STARTED)
    starts = [_start(coarse, order, float(delay)) for delay in delays]
    starts.sort(key=lambda trial: trial.cost)
    near = [start for start in starts[:2] if start.cost <= NEAR * starts[0].cost]
    return min((_refined(data, start, 25) for start in near), key=lambda trial: trial.cost)


def _thinned(data: _Data, count: int) -> _Data:
    """Every k-th frequency of the data, at least ``count`` where there are so many."""
    s = slice(None, None, max(1, len(data.z) // count))
    parts = {name: getattr(data, name)[s] for name in ("omega", "z", "H", "weight")}
    return replace(data, **parts)


def _start(data: _Data, order: int, delay: float) -> _Trial:
    """Sanathanan–Koerner by relocation, from pairs spread over the band; the best round."""
    hz = np.geomspace(data.omega[0], data.omega[-1], order // 2 + 2)[1:-1] * TS
    upper = np.exp((-0.1 + 1j) * hz)
    single = [np.exp(-float(np.median(data.omega)) * TS)] if order % 2 else []
    den = denominator(np.concatenate([upper, upper.conj(), single]), RADIUS)
    trials = []
    for _ in range(ROUNDS):
        den = _relocated(data, den, delay)
        trials.append(_Trial.of(data, den, delay))
    return min(trials, key=lambda trial: trial.cost)


def _relocated(data: _Data, den: Denominator, delay: float) -> Denominator:
    """Poles of the next round: the zeros of σ = 1 + Σ e_i B_i in Σ c_i B_i = σ H."""
    B, own = den.basis(data.z, data.direct), den.basis(data.z)
    H = data.H * np.exp(1j * data.omega * delay)
    w = data.weight[:, None]
    rows = np.hstack([B, -H[:, None] * own]) * w
    at_one = den.basis(np.ones(1, complex), data.direct)
    own = at_one[:, : den.order]
    expected, sd = data.gain if data.at_rest else (0.0, 1.0 / w.sum())
    rows = np.vstack([rows, np.hstack([at_one, -expected * own]) / sd])
    target = np.append(H * data.weight, expected / sd)
    e = _least_squares(rows, target)[B.shape[1] :]
    A, b, T = den.states()
    poles = linalg.eigvals(A - np.outer(b, e @ T))
    return denominator(poles, RADIUS)


def _solve(data: _Data, den: Denominator, delay: float) -> tuple[Array, Array]:
    """Weighted residual (2k + 2h + 3,): real, imaginary, delay; and c of the best zeros."""
    B = data.weight[:, None] * den.basis(data.z, data.direct)
    B = np.vstack([B, data.loosely * den.basis(data.held, data.direct)])
    H = data.weight * data.H * np.exp(1j * data.omega * delay)
    H = np.append(H, np.zeros(len(data.held)))
    b = den.basis(np.ones(1, complex), data.direct)[0].real
    if data.at_rest:  # about 1, as sensors are
        expected, sd = data.gain
        B = np.vstack([B, b / sd])
        H = np.append(H, expected / sd)
        c = _least_squares(B, H)
    else:
        Q, _ = np.linalg.qr(b[:, None], mode="complete")
        c = Q[:, 1:] @ _least_squares(B @ Q[:, 1:], H)
    error = np.asarray(H - B @ c)
    return np.concatenate([error.real, error.imag, [_far(data, delay)]]), c


def _far(data: _Data, delay: float) -> float:
    """How far the delay is from the middle of its bounds: 1 at a bound.

    Zeros at infinity and delay explain the same; where the data say nothing, this does.
    """
    low, high = data.delay_bounds
    return (2.0 * delay - low - high) / (high - low) if high > low else 0.0


def _least_squares(rows: Complex | Array, target: Complex | Array) -> Array:
    """The real x that minimises |rows x − target|, columns scaled to equal length."""
    A = np.vstack([rows.real, rows.imag])
    scale = np.maximum(np.sqrt(np.einsum("ij,ij->j", A, A)), np.finfo(float).tiny)
    both = np.column_stack([A / scale, np.append(target.real, target.imag)])
    R = np.asarray(np.linalg.qr(both, mode="r"))
    d = A.shape[1]
    x = np.linalg.lstsq(R[:d, :d], R[:d, d], rcond=1e-13)[0]
    return np.asarray(x / scale)


def _refined(data: _Data, start: _Trial, steps: int) -> _Trial:
    """The least cost from ``start`` in so many steps of least_squares."""
    low, high = data.delay_bounds
    free = high > low
    x, lower, upper, ringing = _coordinates(start.den, data)
    if free:
        x = np.append(x, start.delay / TS)
        lower, upper = np.append(lower, low / TS), np.append(upper, high / TS)
    unpack = partial(_unpacked, ringing=ringing, fixed=low, free=free)
    room = 1e-3 * (upper - lower)
    result = optimize.least_squares(
        lambda v: _solve(data, *unpack(v))[0],
        np.clip(x, lower + room, upper - room),
        bounds=(lower, upper),
        x_scale="jac",
        max_nfev=steps,
    )
    return _Trial.of(data, *unpack(result.x))


def _coordinates(den: Denominator, data: _Data) -> tuple[Array, Array, Array, list[bool]]:
    """Sections as logarithms, with their bounds, and which sections ring.

    A section that rings: natural frequency (rad per sample) and damping; another: both decays.
    """
    slow, fast, dead = np.log([data.slowest, data.fastest, FASTEST])
    x: list[float] = []
    bounds: list[tuple[float, float]] = []
    ringing = []
    for a1, a2 in den.pairs:
        rings = a1 * a1 / 4.0 < a2
        ringing.append(bool(rings))
        if rings:
            s = np.log(complex(-a1 / 2.0, np.sqrt(a2 - a1 * a1 / 4.0)))
            x += [float(np.log(abs(s))), float(np.log(max(-s.real / abs(s), DAMPING[0])))]
            bounds += [(slow, fast), (np.log(DAMPING[0]), np.log(DAMPING[1]))]
        else:
            x += [_decay(p) for p in den.section_poles(a1, a2)]
            bounds += [(slow, dead)] * 2
    if den.single is not None:
        x.append(_decay(den.single))
        bounds.append((slow, dead))
    lower, upper = np.array(bounds).T
    return np.array(x), lower, upper, ringing


def _decay(pole: complex) -> float:
    """Logarithm of how fast a real pole decays, per sample."""
    return float(np.log(-np.log(np.clip(pole.real, np.exp(-FASTEST), 1.0 - 1e-9))))


def _unpacked(x: Array, ringing: list[bool], fixed: float, free: bool) -> tuple[Denominator, float]:
    pairs = []
    for rings, (first, second) in zip(ringing, x[: 2 * len(ringing)].reshape(-1, 2), strict=True):
        if rings:
            omega, zeta = np.exp(first), np.exp(second)
            radius = np.exp(-zeta * omega)
            turn = np.cos(omega * np.sqrt(1.0 - zeta * zeta))
            pairs.append([-2.0 * radius * turn, radius * radius])
        else:
            p, q = np.exp(-np.exp([first, second]))
            pairs.append([-(p + q), p * q])
    rest = x[2 * len(ringing) :]
    delay = float(rest[-1]) * TS if free else fixed
    single = float(np.exp(-np.exp(rest[0]))) if len(rest) > free else None
    return Denominator(np.array(pairs, float).reshape(-1, 2), single), delay


def _bic(data: _Data, trial: _Trial) -> float:
    n = 2 * len(data.z)
    low, high = data.delay_bounds
    unknowns = 2 * trial.den.order + (high > low)
    unexplained = max(trial.cost - _far(data, trial.delay) ** 2, 0.0)
    return float(n * np.log(unexplained / n + GOOD**2) + unknowns * np.log(n))
