"""A rational discrete transfer function from a measured frequency response.

Model: H(f) = G(e^{jω·TS}) e^{−jωτ}, G(1) exactly 0 or 1. A position (1) has relative degree one
or more; racking (0) may respond in the same sample, as the paper's does.

1. Start: Sanathanan–Koerner iteration as relocation of poles (`rational.Denominator`), for
   several delays within the bounds.
2. scipy.optimize.least_squares on the sections of the denominator and τ. For given poles and
   delay the zeros are a linear problem, so each step solves it exactly (variable
   projection): the minimum is that on poles, zeros and delay together, with fewer unknowns.
3. The order with the least BIC; a lower one that is as good within CLOSE wins. Then step 2
   again with all frequencies.

Sections are searched inside the stability triangle, through tanh, scaled to a pole radius of
RADIUS. Each frequency counts with the noise that its coherence tells, and no noise below
FLOOR is believed. Above the band, where nothing is known, G is held loosely below its peak.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy import linalg, optimize

from hframe_post.arrays import TS, Array, Complex
from hframe_post.errors import IdentificationError
from hframe_post.identification import diagnostics
from hframe_post.identification.frequency_response import FrequencyResponse
from hframe_post.identification.kautz import Denominator, denominator, transfer_function
from hframe_post.model.transfer_function import TransferFunction

RADIUS = 0.999  # largest pole modulus
FLOOR = 0.003  # relative noise of H below which no measurement is believed
SMALL = 0.002  # the same, of the largest |H|
QUIET = 1e-3  # input power, of the median, below which a frequency counts nothing
STARTED = 200  # frequencies, of those measured, for the starts
TRIED = 400  # and to choose the order; all of them for the result
ROUNDS = 10  # of relocation, from each start
DELAY_STEP = 1e-3  # s between starts
GOOD = 0.1  # residual, in units of the noise, below which no better one is wanted
CLOSE = 10.0  # of BIC: very strong evidence (Kass and Raftery 1995)
LOOSE = 1.0  # |G| above the band, of the largest |H|: one standard deviation
NEAR = 4.0  # of the best start's cost, up to which the second is refined too
PATIENCE = 2  # orders without a better score, after which higher ones are not tried


@dataclass(frozen=True)
class Fit:
    """The transfer function ``G`` and how it was found.

    residual: ‖H − Ĥ‖ / ‖H‖ over the band, weighted with input power and coherence. delay: s,
    e^{−jωτ}, not part of G. scores: BIC by order. warnings, notes: sentences for the user.
    """

    G: TransferFunction
    order: int
    residual: float
    delay: float
    scores: dict[int, float]
    warnings: tuple[str, ...]
    notes: tuple[str, ...]

    def response(self, hz: Array) -> Complex:
        """G with its delay at ``hz`` (k,)."""
        omega = 2.0 * np.pi * hz
        return np.asarray(self.G.response(omega * TS) * np.exp(-1j * omega * self.delay))


@dataclass(frozen=True)
class _Data:
    """What is fitted: weights (k,) are one over the standard deviation of H; ``held`` is z
    above the band, ``loosely`` its weight."""

    omega: Array
    z: Complex
    H: Complex
    weight: Array
    at_rest: float
    delay_bounds: tuple[float, float]
    held: Complex
    loosely: float

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
) -> Fit:
    """The transfer function of ``order`` poles, or of the order that the data support.

    at_rest: G(1), 1 for a position, 0 for racking. Raises IdentificationError where the band
    holds too little to fit, ValueError for impossible arguments.
    """
    low, high = delay_bounds_s
    if at_rest not in (0.0, 1.0) or not low <= high:
        raise ValueError("at_rest must be 0 or 1 and the delay's bounds ascend")
    if order is not None and order < 1:
        raise IdentificationError(f"order {order} is too low; 1 is the least")
    part = response.within(band_hz)
    data = _data(part, at_rest, delay_bounds_s)
    top = max_order if order is None else order
    if len(data.z) < 2 * top + 2:
        raise IdentificationError(
            f"{len(data.z)} frequencies in {band_hz[0]:g}–{band_hz[1]:g} Hz are too few "
            f"for order {top}"
        )
    orders = range(1, max_order + 1) if order is None else [order]
    trials, scores = _tried(_thinned(data, TRIED), orders)
    chosen = _chosen(scores)
    best = _refined(data, trials[chosen], 100)
    delay = best.delay
    G = transfer_function(best.den, best.c, at_rest, data.z)
    model = G.response(data.omega * TS) * np.exp(-1j * data.omega * delay)
    w = part.power * part.coherence
    residual = float(np.sqrt((w * abs(part.H - model) ** 2).sum() / (w * abs(part.H) ** 2).sum()))
    texts = diagnostics.of_data(part) + diagnostics.of_roots(G, band_hz)
    texts += diagnostics.of_delay(delay, delay_bounds_s)
    texts += diagnostics.of_order(G, float(np.sqrt(best.cost / len(data.z))))
    notes, costly = diagnostics.of_zeros(G)
    return Fit(G, chosen, residual, delay, scores, (*texts, *costly), notes)


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


def _data(part: FrequencyResponse, at_rest: float, bounds: tuple[float, float]) -> _Data:
    if not (np.isfinite(part.H).all() and np.isfinite(part.coherence).all()):
        raise IdentificationError("the frequency response has values that are not finite")
    largest = float(np.abs(part.H).max(initial=0.0))
    if largest == 0.0 or not (part.power * part.coherence).any():
        raise IdentificationError("the frequency response or its coherence is zero in the band")
    sd = np.hypot(np.hypot(part.noise, FLOOR) * np.abs(part.H), SMALL * largest)
    heard = part.power > QUIET * np.median(part.power)
    omega = 2.0 * np.pi * part.hz
    top = 1.5 * part.hz.max()
    held = np.exp(2j * np.pi * TS * np.linspace(top, 0.5 / TS, 8)) if top < 0.4 / TS else None
    return _Data(
        omega,
        np.exp(1j * omega * TS),
        part.H,
        heard / sd,
        at_rest,
        bounds,
        np.zeros(0, complex) if held is None else held,
        1.0 / (LOOSE * largest),
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
    rows = np.vstack([rows, np.hstack([at_one, -data.at_rest * own]) * w.sum()])
    target = np.append(H * data.weight, data.at_rest * w.sum())
    e = _least_squares(rows, target)[B.shape[1] :]
    A, b, T = den.states()
    poles = linalg.eigvals(A - np.outer(b, e @ T))
    return denominator(poles, RADIUS)


def _solve(data: _Data, den: Denominator, delay: float) -> tuple[Array, Array]:
    """Weighted residual (2k + 2h + 1,): real, imaginary, delay; and c of the best zeros."""
    B = data.weight[:, None] * den.basis(data.z, data.direct)
    B = np.vstack([B, data.loosely * den.basis(data.held, data.direct)])
    H = data.weight * data.H * np.exp(1j * data.omega * delay)
    H = np.append(H, np.zeros(len(data.held)))
    b = den.basis(np.ones(1, complex), data.direct)[0].real
    Q, _ = np.linalg.qr(b[:, None], mode="complete")
    c0, free = b * (data.at_rest / (b @ b)), Q[:, 1:]
    c = c0 + free @ _least_squares(B @ free, H - B @ c0)
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
    x = _coordinates(start.den)
    if free:
        inside = float(np.clip(start.delay, low + 1e-3 * (high - low), high - 1e-3 * (high - low)))
        x = np.append(x, inside / TS)
    lower, upper = np.full(len(x), -20.0), np.full(len(x), 20.0)
    if free:
        lower[-1], upper[-1] = low / TS, high / TS
    unpack = partial(_unpacked, order=start.den.order, fixed=low, free=free)
    result = optimize.least_squares(
        lambda v: _solve(data, *unpack(v))[0],
        np.clip(x, lower + 1e-9, upper - 1e-9),
        bounds=(lower, upper),
        x_scale="jac",
        max_nfev=steps,
    )
    return _Trial.of(data, *unpack(result.x))


def _coordinates(den: Denominator) -> Array:
    """Sections as points of the plane: artanh of the place in the stability triangle."""
    a2 = den.pairs[:, 1] / RADIUS**2
    a1 = den.pairs[:, 0] / RADIUS / (1.0 + a2)
    out = np.column_stack([a1, a2]).ravel()
    if den.single is not None:
        out = np.append(out, den.single / RADIUS)
    return np.arctanh(np.clip(out, -1.0 + 1e-9, 1.0 - 1e-9))


def _unpacked(x: Array, order: int, fixed: float, free: bool) -> tuple[Denominator, float]:
    place = np.tanh(x[:order])
    a2 = place[1 : order - order % 2 : 2]
    a1 = place[0 : order - order % 2 : 2] * (1.0 + a2)
    single = RADIUS * float(place[-1]) if order % 2 else None
    pairs = np.column_stack([RADIUS * a1, RADIUS**2 * a2])
    return Denominator(pairs, single), float(x[-1]) * TS if free else fixed


def _bic(data: _Data, trial: _Trial) -> float:
    n = 2 * len(data.z)
    low, high = data.delay_bounds
    unknowns = 2 * trial.den.order - 1 + data.direct + (high > low)
    unexplained = max(trial.cost - _far(data, trial.delay) ** 2, 0.0)
    return float(n * np.log(unexplained / n + GOOD**2) + unknowns * np.log(n))
