"""The response of an axis by regularised regression, with a known and with an unknown start.

    H(f) = g·e^{−2πifτ}·G(f) + e,   G = rest − lag·(1 − 1/z) + (z − 2 + 1/z)·Q(z)

G is linear in lag and q: a regression with the kernel of ``regression`` for q. What no linear model
explains counts as noise, whose power by frequency is that of what is left (the best linear
approximation; Pintelon, Schoukens, System Identification, 2012). What is known beforehand differs:

===================  ==========  ==================  ============================================
recordings           gain g      start τ             response
===================  ==========  ==================  ============================================
strokes              1 ± 0.05    0                   rest = 1, lag within ± 10 ms
racking              as x        as x                rest = 0, lag = 0
tests, linear        1 ± 0.05    the rest of it      lag = what the damping of the modes explains
others               from below resonance            one ideal mode there, lag = 0
===================  ==========  ==================  ============================================

**An unknown start** is found from the response itself. Below a resonance at f₀ every printer does
what its strongest mode alone does, 1/(1 − (f/f₀)²), which shows gain and start roughly. Where modes
explain the whole recording, their damping tells how late the printer is at low speed, and the rest
is the start. Other printers are not sums of a few modes. Their response h is estimated as it is,

    ĥ = argmin Σ_f W(f) |H(f) − Σ_k h_k e^{−2πifk}|² + (h − δ)ᵀ K⁻¹ (h − δ)

with the ideal mode from 0.25 f₀ down, and up to 0.42 f₀ less and less, and written as
what acceleration does, so that its gain at rest is exact.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.fft import irfft, rfft
from scipy.ndimage import uniform_filter1d

from hframe_post.arrays import TS, Array, Complex
from hframe_post.errors import IdentificationError
from hframe_post.identification.estimation.fit import Fit, described, shares
from hframe_post.identification.estimation.frequency_response import (
    BANDWIDTH,
    FrequencyResponse,
    largest_response,
    share_left,
)
from hframe_post.identification.estimation.regression import (
    LEAST_GAIN,
    Data,
    Decay,
    Mode,
    Posterior,
    Prior,
    posterior,
    regress,
    rows,
    transfer,
)
from hframe_post.model.impulse_response import ImpulseResponse

# standard deviations of what is known of recordings beforehand: the sensor's gain, and the lag in
# samples
KNOWN = (0.05, 10.0)
# samples of q, which begins before the command, since that is band-limited, and in which it decays;
# modes may ring for longer
DECAYING: Array = np.arange(-4.0, 436.0)
LONGEST = 1900  # samples of q
SILENT = 2e-3  # of the largest q
NOISE_HZ = 4.0  # over which the noise is alike
NOISE = 0.1  # share of command and response that counts as noise at first
LEAST_NOISE = 2e-3  # and at least
UNKNOWN = 64  # samples of the filter that holds the uncertainty


# ---------------------------------------------------------------------- a known start


def fit_known_start(whole: FrequencyResponse) -> Fit:
    """Return the response of recordings whose start is known: all delay is the printer's.

    Raises IdentificationError if there are too few frequencies.
    """
    found = estimated(whole)
    return described(found, whole, found.lag)


def fit_racking(whole: FrequencyResponse, x: Fit, gain: float) -> Fit:
    """Return what x does to the angle, which is 0 at rest.

    whole: rad/mm, as measured by a sensor of that gain in the recordings that ``x`` is of. Raises
    IdentificationError if there are too few frequencies.
    """
    scale = largest_response(whole)
    in_step = whole.corrected(scale, x.delay)
    found = estimated(in_step, rest=0.0)
    left = share_left(found.G.response(2.0 * np.pi * TS * whole.hz), in_step, whole.power)
    q, unknown = (values * (scale / gain) for values in (found.G.deviation, found.G.unknown))
    G = replace(found.G, deviation=q, unknown=unknown)
    return replace(found, G=G, gain=gain, delay=x.delay, residual=left)


def estimated(measured: FrequencyResponse, rest: float = 1.0, start: Prior | None = None) -> Fit:
    """Return the response that was measured, with what is not known of it.

    All delay is the printer's. rest: the gain at rest, 1 or 0. start: hyperparameters of a part of
    the measurement; without them modes are sought. Raises IdentificationError if there are too few
    frequencies.
    """
    found, resonance_hz = _regressed(measured, rest, start)
    gain, lag, sd = 1.0, 0.0, 0.0
    if rest:
        gain += float(found.mean[0])
        lag, sd = float(found.mean[1]) / gain, float(np.sqrt(found.covariance[0, 0]))
    k = np.arange(DECAYING[0], LONGEST)
    q = found.response(k) / gain
    loud = int(np.flatnonzero(np.abs(q) >= SILENT * np.abs(q).max())[-1]) + 1
    unknown = _unknown(found.known(k[:loud]) / gain**2)
    G = ImpulseResponse(q[:loud], int(-k[0]), rest, lag, unknown=unknown)
    return Fit(G, gain, 0.0, resonance_hz, found.prior, gain_sd=sd)


def _regressed(
    measured: FrequencyResponse, rest: float, start: Prior | None
) -> tuple[Posterior, float]:
    """Return the posterior of (g − ĝ, g·lag, g·q), and where its mean is greatest, Hz."""
    largest_response(measured)
    linear, H, power = _Linear(measured, rest), measured.H, measured.power
    least = power * (np.abs(H) ** 2 + 1.0) / measured.averages
    own = np.maximum(power * (measured.noise * np.abs(H)) ** 2, LEAST_NOISE**2 * least)
    left, prior = np.zeros(len(H)), start
    sought = start is None and bool((own > NOISE**2 * least).any())
    for noise in (NOISE**2 * least, own, own)[start is not None :]:
        weight = np.sqrt(2.0 * power / _smoothed(noise + left, measured.hz))
        data = linear.data(weight)
        found = regress(data, prior)
        if sought and prior is not None:  # what looked like modes at first may be noise
            again, sought = regress(data), False
            found = again if again.cost < found.cost - LEAST_GAIN else found
        prior, modelled = found.prior, linear.modelled(found)
        # what no linear model explains counts as noise
        left = power * np.abs(H - modelled) ** 2 / measured.averages
    return found, float(measured.hz[np.argmax(np.abs(modelled))])


class _Linear:
    """A measured response as a linear function of (g − ĝ, g·lag, g·q) and of what modes add."""

    def __init__(self, measured: FrequencyResponse, rest: float) -> None:
        self._z: Complex = np.exp(2j * np.pi * TS * measured.hz)
        self._H, self._rest = measured.H, rest
        self._acceleration = self._z - 2.0 + 1.0 / self._z
        q = self._acceleration[:, None] * _turn(measured.hz, DECAYING)
        scalars = [np.ones(len(self._z)), 1.0 / self._z - 1.0] if rest else []
        self._columns = np.column_stack([*scalars, q])
        self._precision = np.array(KNOWN[: len(scalars)]) ** -2.0

    def data(self, weight: Array) -> Data:
        """Return the data of a regression, for 1 / noise (k,)."""

        def by_modes(modes: Sequence[Mode]) -> Array:
            return rows(weight, self._ringing(modes))

        X, y = rows(weight, self._columns), rows(weight, self._H - self._rest)
        return Data.of(X, y, DECAYING, self._precision, by_modes)

    def modelled(self, found: Posterior) -> Complex:
        """Return the mean of the response (k,)."""
        columns = np.hstack([self._columns, self._ringing(found.prior.modes)])
        return np.asarray(self._rest + columns @ found.mean.astype(complex))

    def _ringing(self, modes: Sequence[Mode]) -> Complex:
        return np.asarray(self._acceleration[:, None] * transfer(self._z, modes))


def _turn(hz: Array, k: Array) -> Complex:
    return np.asarray(np.exp(-2j * np.pi * TS * np.outer(hz, k)))


def _smoothed(noise: Array, hz: Array) -> Array:
    """Return the power of the noise (k,), alike over NOISE_HZ."""
    bins = max(int(NOISE_HZ / (hz[1] - hz[0])), 1)
    return np.asarray(uniform_filter1d(noise, bins, mode="nearest"))


def _unknown(covariance: Array) -> Array:
    """Return the filter (UNKNOWN,) whose gain at each frequency is the standard deviation of Q.

    Of all filters of that gain the one of minimum phase, from the cepstrum of the gain.
    """
    m, fine = len(covariance), 4096  # frequencies; more than twice the longest response
    # var Q(f) = Σ_d e^{−2πifd} Σ_k cov(k + d, k)
    sums = np.array([np.trace(covariance, d) for d in range(m)])
    around = np.zeros(fine)
    around[:m], around[fine - m + 1 :] = sums, sums[:0:-1]
    variance = np.maximum(rfft(around).real, 0.0)
    log_gain = 0.5 * np.log(np.maximum(variance, 1e-12 * variance.max() + 1e-300))
    cepstrum = irfft(log_gain, fine)
    cepstrum[1 : fine // 2] *= 2.0
    cepstrum[fine // 2 + 1 :] = 0.0
    return np.asarray(irfft(np.exp(rfft(cepstrum)), fine)[:UNKNOWN])


# ---------------------------------------------------------------------- an unknown start

# share of the measurement that a response without an assumed mode may leave: of drawn linear
# printers 0.005 to 0.035, of real ones 0.06 to 0.3
LINEAR = 0.05
CUT_OFF = 0.01  # of a mode that still rings at the end: such a printer leaves 0.06 to 0.23
STRONGEST_HZ = (18.0, 95.0)  # in which f₀ is sought
ASSUMED = (0.25, 0.42)  # of f₀: one ideal mode below, the measurement above
MIDDLE = sum(ASSUMED) / 2.0
IDEAL_SD = 0.003  # of that mode, below the middle
UNEXPLAINED = 0.25  # share of the response that counts as noise, since no linear model explains it
SMOOTH = Decay(0.06, 0.0151, 0.1)  # the kernel of h, and but for its size of the result
H_AT: Array = np.arange(-12.0, 400.0)  # samples of h, which begins early, since it is band-limited
Q_AT: Array = np.arange(-32.0, 408.0)  # of the result
FIT_HZ = 125.0  # up to which the result is fitted
FIT_WEIGHT = 270.0  # of the result at SLOW_HZ, against its kernel
SLOW_HZ = 5.0  # of strokes as long as a bed


def fit_unknown_start(axes: Mapping[str, FrequencyResponse]) -> dict[str, Fit]:
    """Return the responses of recordings whose start and gain are unknown: all delay is theirs.

    If one axis is not linear, both are taken not to be late: one of each would pull x and y apart.
    Raises IdentificationError.
    """
    ideal = {name: with_an_ideal_mode(whole) for name, whole in axes.items()}
    if any(one.residual > LINEAR and not _is_cut_off(one) for one in ideal.values()):
        return ideal
    damped = {name: _from_its_damping(whole) for name, whole in axes.items()}
    linear = all(one.residual <= LINEAR for one in damped.values())
    return damped if linear else ideal


def _is_cut_off(ideal: Fit) -> bool:
    """Return whether a mode rings for longer than the response with an ideal mode lasts."""
    seconds = TS * Q_AT[-1]
    return any(np.exp(-2.0 * np.pi * hz * zeta * seconds) > CUT_OFF for hz, zeta in ideal.modes)


def _from_its_damping(whole: FrequencyResponse) -> Fit:
    """Return the response that is as late at low speed as the damping of its modes explains."""
    gain, late, _ = _gain_and_delay(whole, strongest(whole))
    late += DECAYING[0] * TS  # the rough one may be late
    in_time = whole.corrected(gain, late)
    rough = estimated(in_time)
    if modes := rough.ringing:
        seen = in_time.where(whole.hz >= rough.resonance_hz * MIDDLE)
        late += shares(seen, modes, rough.lag, speed=False)[1]
    else:  # too stiff to ring, so in time with it
        late += rough.lag
    found = estimated(whole.corrected(gain, late))
    return described(replace(found, gain=gain * found.gain, delay=late), whole, late)


def with_an_ideal_mode(whole: FrequencyResponse) -> Fit:
    """Return the response that follows its command below the resonance as one mode does.

    Raises IdentificationError if too little was excited.
    """
    largest_response(whole)
    f0 = strongest(whole)
    gain, delay, sd = _gain_and_delay(whole, f0)
    h = _estimate(whole.corrected(gain, delay), f0)
    return described(Fit(_handed_over(h, f0), gain, delay, f0, gain_sd=sd), whole, delay)


def strongest(measured: FrequencyResponse) -> float:
    """Return the frequency of the strongest mode, Hz."""
    hz = measured.hz
    near = (hz >= STRONGEST_HZ[0]) & (hz <= STRONGEST_HZ[1])
    return float(hz[np.argmax(np.where(near, np.abs(measured.H), 0.0))])


def _gain_and_delay(measured: FrequencyResponse, f0: float) -> tuple[float, float, float]:
    """Return the gain and delay (s) with which one ideal mode is seen below the resonance.

    And how far off that gain half of the frequencies there are.
    """
    hz, ends = measured.hz, (f0 / 5.0, f0 / 2.4)
    low = (hz >= ends[0]) & (hz <= ends[1])
    H, omega = measured.H[low], 2.0 * np.pi * hz[low]
    if not low.any():
        raise IdentificationError(
            f"nothing was excited between {ends[0]:.0f} and {ends[1]:.0f} Hz, below the "
            f"resonance at {f0:.0f} Hz: begin the test at a lower frequency"
        )
    sign = np.sign(H.sum().real) or 1.0
    first, size, last = np.quantile(np.abs(H / _one_mode(hz[low], f0)), (0.25, 0.5, 0.75)).tolist()
    phase = np.unwrap(np.angle(H * sign))
    delay = float(-(omega @ phase) / (omega @ omega))
    return float(sign * size), delay, max(size - first, last - size)


def _estimate(measured: FrequencyResponse, f0: float) -> Array:
    """Return ĥ − δ at H_AT."""
    seen = measured.where(measured.hz >= MIDDLE * f0)
    low = np.arange(0.0, MIDDLE * f0, 0.5)
    power = seen.power / (seen.power @ np.abs(seen.H) ** 2)
    step = float(np.median(np.diff(measured.hz)))
    samples = measured.averages * 2.0 / (BANDWIDTH * step * TS)
    by_noise = np.sqrt(samples * power) / UNEXPLAINED
    weight = np.concatenate([np.full(len(low), 1.0 / IDEAL_SD), by_noise])
    wanted = np.concatenate([_one_mode(low, f0), seen.H]) - 1.0
    turn = _turn(np.concatenate([low, seen.hz]), H_AT)
    return _mean(weight, turn, wanted, H_AT, SMOOTH)


def _handed_over(h: Array, f0: float) -> ImpulseResponse:
    """Return h − δ as what acceleration does, with one ideal mode where the phase is unknown."""
    hz = np.arange(0.25, FIT_HZ, 0.25)
    at = np.clip((hz / f0 - ASSUMED[0]) / (ASSUMED[1] - ASSUMED[0]), 0.0, 1.0)
    known = at * at * (3.0 - 2.0 * at)
    ideal = _one_mode(np.minimum(hz, 0.7 * f0), f0) - 1.0
    off = (1.0 - known) * ideal + known * (_turn(hz, H_AT) @ h)
    X = -((2.0 * np.sin(np.pi * TS * hz[:, None])) ** 2) * _turn(hz, Q_AT)
    # the acceleration of a stroke is as strong below SLOW_HZ, where Q counts as a whole
    weight = FIT_WEIGHT * np.maximum(SLOW_HZ / hz, 1.0) ** 2 / np.maximum(hz / SLOW_HZ, 1.0) ** 1.5
    q = _mean(weight, X, off, Q_AT, replace(SMOOTH, c=1.0 / (2.0 * np.pi * TS * f0)))
    return ImpulseResponse(q, int(-Q_AT[0]))


def _mean(
    weight: Array, columns: Complex, wanted: Array | Complex, k: Array, kernel: Decay
) -> Array:
    """Return the mean of a response at samples k (m,), by a kernel that is known."""
    data = Data.of(rows(weight, columns), rows(weight, wanted), k)
    return posterior(data, Prior(kernel)).mean


def _one_mode(hz: Array, f0: float) -> Array:
    return np.asarray(1.0 / (1.0 - (hz / f0) ** 2))
