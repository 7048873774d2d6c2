"""The response of an axis by regularised regression, with a known and with an unknown start.

    H(f) = g·e^{−2πifτ}·G(f) + e,   G = rest − lag·(1 − 1/z) + (z − 2 + 1/z)·Q(z)

G is linear in lag and q: a regression with the kernel of ``kernel`` for q. What no linear model
explains counts as noise, whose power by frequency is that of what is left (the best linear
approximation; Pintelon, Schoukens, System Identification, 2012). Priors differ:

===================  ==========  ==================  ============================================
recordings           gain g      start τ             response
===================  ==========  ==================  ============================================
strokes              1 ± 0.03    0                   rest = 1, lag within ± 10 ms
racking              as x        as x                rest = 0, lag = 0
others, linear       1 ± 0.05    the rest of it      lag = what the damping of the modes explains
others               from below resonance            one ideal mode there, lag = 0
===================  ==========  ==================  ============================================

**An unknown start** is found from the response itself. Below a resonance at f₀ every printer does
what its strongest mode alone does, 1/(1 − (f/f₀)²), which shows gain and start roughly. Where modes
explain the whole recording, their damping tells how late the printer is at low speed, and the rest
is the start. Other printers are not sums of a few modes. Their response h is estimated as it is,

    ĥ = argmin Σ_f W(f) |H(f) − Σ_k h_k e^{−2πifk}|² + (h − δ)ᵀ K⁻¹ (h − δ)

with the ideal mode from ASSUMED[0]·f₀ down, and up to ASSUMED[1]·f₀ less and less, and written as
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
    SENSOR,
    FrequencyResponse,
    advanced,
    largest_response,
    share_left,
)
from hframe_post.identification.estimation.kernel import Decay, Mode, Prior, transfer
from hframe_post.identification.estimation.regression import (
    LEAST_GAIN,
    Data,
    Posterior,
    posterior,
    regress,
    rows,
)
from hframe_post.model.impulse_response import ImpulseResponse

ROUGH = (1.0, 0.05)  # gain, as mean and standard deviation, after a rough one
RACKING = (0.0, 1e-6)  # what is 0 at rest
LAG_SD = 10.0  # samples
BEFORE = 4  # samples of q before the command, since it is band-limited
AFTER = 436  # samples in which it decays; modes may ring for longer
LONGEST = 1900  # samples of q
SILENT = 2e-3  # of the largest q
NOISE_HZ = 4.0  # over which the noise is alike
NOISE = 0.1  # share of command and response that counts as noise at first
LEAST_NOISE = 2e-3  # and at least
UNKNOWN = 64  # samples of the filter that holds the uncertainty
FINE = 4096


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
    in_step, scale = advanced(whole, x.delay), largest_response(whole)
    found, resonance_hz = _regressed(replace(in_step, H=in_step.H / scale), RACKING, 0.0)
    G = _response(found, 0.0, 0.0, scale / gain)
    fit = Fit(G, gain, 0.0, resonance_hz, found.prior.modes)
    left = share_left(fit.response(whole.hz), in_step, whole.power)
    return replace(fit, residual=left, delay=x.delay)


def estimated(measured: FrequencyResponse, sensor: tuple[float, float] = SENSOR) -> Fit:
    """Return the response of an axis that was measured, with what is not known of it.

    All delay is the printer's. sensor: mean and standard deviation of its gain. Raises
    IdentificationError if there are too few frequencies.
    """
    found, resonance_hz = _regressed(measured, sensor, LAG_SD)
    gain, lag = float(sensor[0] + found.mean[0]), float(found.mean[1])
    G = _response(found, 1.0, lag / gain, 1.0 / gain)
    return Fit(G, gain, 0.0, resonance_hz, found.prior.modes)


def _response(found: Posterior, rest: float, lag: float, scale: float) -> ImpulseResponse:
    """Return the response, as far as it is loud, and what is not known of it."""
    k = np.arange(-BEFORE, LONGEST, dtype=float)
    q = found.response(k)
    loud = int(np.flatnonzero(np.abs(q) >= SILENT * np.abs(q).max())[-1]) + 1
    unknown = _unknown(found.known(k[:loud]) * scale**2)
    return ImpulseResponse(scale * q[:loud], BEFORE, rest, lag, unknown=unknown)


def _regressed(
    measured: FrequencyResponse, sensor: tuple[float, float], lag_sd: float
) -> tuple[Posterior, float]:
    """Return the posterior of (g − ĝ, g·lag, g·q), and where its mean is greatest, Hz."""
    largest_response(measured)
    linear, H, power = _Linear(measured, sensor, lag_sd), measured.H, measured.power
    least = power * (np.abs(H) ** 2 + 1.0) / measured.averages
    own = np.maximum(power * (measured.noise * np.abs(H)) ** 2, LEAST_NOISE**2 * least)
    left, prior = np.zeros(len(H)), None
    sought = bool((own > NOISE**2 * least).any())
    for noise in (NOISE**2 * least, own, own):
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

    def __init__(
        self, measured: FrequencyResponse, sensor: tuple[float, float], lag_sd: float
    ) -> None:
        self._k = np.arange(-BEFORE, AFTER, dtype=float)
        self._z: Complex = np.exp(2j * np.pi * TS * measured.hz)
        self._H, self._gain = measured.H, sensor[0]
        self._precision = np.array([sensor[1], max(lag_sd, RACKING[1])]) ** -2.0
        self._acceleration = self._z - 2.0 + 1.0 / self._z
        q = self._acceleration[:, None] * _turn(measured.hz, self._k)
        self._columns = np.column_stack([np.ones(len(self._z)), 1.0 / self._z - 1.0, q])

    def data(self, weight: Array) -> Data:
        """Return the data of a regression, for 1 / noise (k,)."""

        def by_modes(modes: Sequence[Mode], onset: int) -> Array:
            return rows(weight, self._ringing(modes, onset))

        X, y = rows(weight, self._columns), rows(weight, self._H - self._gain)
        return Data.of(X, y, self._k, self._precision, by_modes)

    def modelled(self, found: Posterior) -> Complex:
        """Return the mean of the response (k,)."""
        ringing = self._ringing(found.prior.modes, found.prior.onset)
        columns = np.hstack([self._columns, ringing])
        return np.asarray(self._gain + columns @ found.mean.astype(complex))

    def _ringing(self, modes: Sequence[Mode], onset: int) -> Complex:
        return np.asarray(self._acceleration[:, None] * transfer(self._z, modes, onset))


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
    m = len(covariance)
    # var Q(f) = Σ_d e^{−2πifd} Σ_k cov(k + d, k)
    sums = np.array([np.trace(covariance, d) for d in range(m)])
    around = np.zeros(FINE)
    around[:m], around[FINE - m + 1 :] = sums, sums[:0:-1]
    variance = np.maximum(rfft(around).real, 0.0)
    log_gain = 0.5 * np.log(np.maximum(variance, 1e-12 * variance.max() + 1e-300))
    cepstrum = irfft(log_gain, FINE)
    cepstrum[1 : FINE // 2] *= 2.0
    cepstrum[FINE // 2 + 1 :] = 0.0
    return np.asarray(irfft(np.exp(rfft(cepstrum)), FINE)[:UNKNOWN])


# ---------------------------------------------------------------------- an unknown start

# share of the measurement that a response without an assumed mode may leave: of drawn linear
# printers 0.005 to 0.035, of real ones 0.06 to 0.3
LINEAR = 0.05
STRONGEST_HZ = (18.0, 95.0)  # in which f₀ is sought
ASSUMED = (0.25, 0.42)  # of f₀: one ideal mode below, the measurement above
MIDDLE = sum(ASSUMED) / 2.0
IDEAL_SD = 0.003  # of that mode, below the middle
UNEXPLAINED = 0.25  # share of the response that counts as noise, since no linear model explains it
SIZE, BETA, ALPHA = 0.06, 0.0151, 0.1054  # of the kernel of h, and of the result's
ADVANCE, RINGING = 12, 400  # samples of h before the command, since it is band-limited, and after
LEAD, LENGTH = 32, 440  # samples of the result
FIT_HZ = 125.0, 0.25  # up to which, and how densely, the result is fitted
FIT_WEIGHT = 270.0  # of the result at SLOW_HZ, against its kernel
SLOW_HZ = 5.0  # of strokes as long as a bed


def fit_unknown_start(axes: Mapping[str, FrequencyResponse]) -> dict[str, Fit]:
    """Return the responses of recordings whose start and gain are unknown: all delay is theirs.

    If one axis is not linear, both are taken not to be late: one of each would pull x and y apart.
    Raises IdentificationError.
    """
    ideal = {name: with_an_ideal_mode(whole) for name, whole in axes.items()}
    if any(one.residual > LINEAR for one in ideal.values()):
        return ideal
    damped = {name: _from_its_damping(whole) for name, whole in axes.items()}
    linear = all(one.residual <= LINEAR for one in damped.values())
    return damped if linear else ideal


def _from_its_damping(whole: FrequencyResponse) -> Fit:
    """Return the response that is as late at low speed as the damping of its modes explains."""
    gain, late = _gain_and_delay(whole, strongest(whole))
    late -= BEFORE * TS  # the rough one may be late
    scaled = replace(whole, H=whole.H / gain)
    in_time = advanced(scaled, late)
    rough = estimated(in_time, ROUGH)
    if modes := rough.ringing:
        seen = in_time.where(whole.hz >= rough.resonance_hz * MIDDLE)
        late += shares(seen, modes, rough.lag, speed=False)[1]
    else:  # too stiff to ring, so in time with it
        late += rough.lag
    found = estimated(advanced(scaled, late), ROUGH)
    return described(replace(found, gain=gain * found.gain, delay=late), whole, late)


def with_an_ideal_mode(whole: FrequencyResponse) -> Fit:
    """Return the response that follows its command below the resonance as one mode does.

    Raises IdentificationError if too little was excited.
    """
    largest_response(whole)
    f0 = strongest(whole)
    gain, delay = _gain_and_delay(whole, f0)
    in_time = advanced(replace(whole, H=whole.H / gain), delay)
    h = _estimate(in_time, f0)
    return described(Fit(_handed_over(h, f0), gain, delay, f0), whole, delay)


def strongest(measured: FrequencyResponse) -> float:
    """Return the frequency of the strongest mode, Hz."""
    hz = measured.hz
    near = (hz >= STRONGEST_HZ[0]) & (hz <= STRONGEST_HZ[1])
    return float(hz[np.argmax(np.where(near, np.abs(measured.H), 0.0))])


def _gain_and_delay(measured: FrequencyResponse, f0: float) -> tuple[float, float]:
    """Return the gain and delay (s) with which one ideal mode is seen below the resonance."""
    hz, ends = measured.hz, (f0 / 5.0, f0 / 2.4)
    low = (hz >= ends[0]) & (hz <= ends[1])
    H, omega = measured.H[low], 2.0 * np.pi * hz[low]
    if not low.any():
        raise IdentificationError(
            f"nothing was excited between {ends[0]:.0f} and {ends[1]:.0f} Hz, below the "
            f"resonance at {f0:.0f} Hz: begin the test at a lower frequency"
        )
    sign = np.sign(H.sum().real) or 1.0
    gain = float(sign * np.median(np.abs(H / _one_mode(hz[low], f0))))
    phase = np.unwrap(np.angle(H / gain))
    return gain, float(-(omega @ phase) / (omega @ omega))


def _estimate(measured: FrequencyResponse, f0: float) -> Array:
    """Return ĥ − δ (ADVANCE + RINGING,) from sample −ADVANCE on."""
    seen = measured.where(measured.hz >= MIDDLE * f0)
    low, k = np.arange(0.0, MIDDLE * f0, 0.5), np.arange(-ADVANCE, RINGING, dtype=float)
    power = seen.power / (seen.power @ np.abs(seen.H) ** 2)
    step = float(np.median(np.diff(measured.hz)))
    samples = measured.averages * 2.0 / (BANDWIDTH * step * TS)
    by_noise = np.sqrt(samples * power) / UNEXPLAINED
    weight = np.concatenate([np.full(len(low), 1.0 / IDEAL_SD), by_noise])
    wanted = np.concatenate([_one_mode(low, f0), seen.H]) - 1.0
    turn = _turn(np.concatenate([low, seen.hz]), k)
    return _mean(weight, turn, wanted, k, SIZE)


def _handed_over(h: Array, f0: float) -> ImpulseResponse:
    """Return h − δ as what acceleration does, with one ideal mode where the phase is unknown."""
    hz = np.arange(FIT_HZ[1], FIT_HZ[0], FIT_HZ[1])
    at = np.clip((hz / f0 - ASSUMED[0]) / (ASSUMED[1] - ASSUMED[0]), 0.0, 1.0)
    known = at * at * (3.0 - 2.0 * at)
    ideal = _one_mode(np.minimum(hz, 0.7 * f0), f0) - 1.0
    off = (1.0 - known) * ideal + known * (_turn(hz, np.arange(-ADVANCE, RINGING, dtype=float)) @ h)
    k = np.arange(-LEAD, LENGTH - LEAD, dtype=float)
    X = -((2.0 * np.sin(np.pi * TS * hz[:, None])) ** 2) * _turn(hz, k)
    # the acceleration of a stroke is as strong below SLOW_HZ, where Q counts as a whole
    weight = FIT_WEIGHT * np.maximum(SLOW_HZ / hz, 1.0) ** 2 / np.maximum(hz / SLOW_HZ, 1.0) ** 1.5
    q = _mean(weight, X, off, k, 1.0 / (2.0 * np.pi * TS * f0))
    return ImpulseResponse(q, LEAD)


def _mean(weight: Array, columns: Complex, wanted: Array | Complex, k: Array, size: float) -> Array:
    """Return the mean of a response at samples k (m,), by a kernel that is known."""
    data = Data.of(rows(weight, columns), rows(weight, wanted), k)
    return posterior(data, Prior(Decay(size, BETA, ALPHA))).mean


def _one_mode(hz: Array, f0: float) -> Array:
    return np.asarray(1.0 / (1.0 - (hz / f0) ** 2))
