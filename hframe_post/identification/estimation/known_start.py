"""The response of an axis from recordings that tell when the motion began.

    H(f) = g·G(f) + e,   G = 1 − lag·(1 − 1/z) + (z − 2 + 1/z)·Q(z)

is linear in g, g·lag and g·q: ordinary regression, with a kernel for q (``regression``).
What no linear model explains counts as noise, whose power by frequency is that of what is left
(the best linear approximation; Pintelon, Schoukens, System Identification, 2012).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.fft import irfft, rfft
from scipy.ndimage import uniform_filter1d

from hframe_post.arrays import TS, Array, Complex
from hframe_post.identification.estimation.frequency_response import (
    SENSOR,
    FrequencyResponse,
    largest_response,
)
from hframe_post.identification.estimation.regression import (
    LEAST_GAIN,
    Data,
    Fit,
    Mode,
    Posterior,
    Prior,
    regress,
    rows,
    transfer,
)
from hframe_post.model.impulse_response import ImpulseResponse

BEFORE = 4  # samples of q before the command, since it is band-limited
AFTER = 436  # samples in which it decays; modes may ring for longer
LONGEST = 1900  # samples of q
SILENT = 2e-3  # of the largest q
NOISE_HZ = 4.0  # over which the noise is alike
NOISE = 0.1  # share of command and response that counts as noise at first
LEAST_NOISE = 2e-3  # and at least
LAG_SD = 10.0  # samples
UNKNOWN = 64  # samples of the filter that holds the uncertainty
FINE = 4096
NONE = 1e-6  # standard deviation of what is zero
NOTHING = (0.0, NONE)  # gain at rest of racking


def estimated(measured: FrequencyResponse, sensor: tuple[float, float] = SENSOR) -> Fit:
    """Return the response of an axis that was measured, with what is not known of it.

    All delay is the printer's. sensor: mean and standard deviation of its gain. Raises
    IdentificationError if there are too few frequencies.
    """
    found, resonance_hz = _regressed(measured, sensor, None)
    gain, lag = float(sensor[0] + found.mean[0]), float(found.mean[1])
    G = _response(found, 1.0, lag / gain, 1.0 / gain)
    return Fit(G, gain, 0.0, resonance_hz, found.prior.modes)


def estimated_racking(measured: FrequencyResponse, gain: float, in_time: bool) -> Fit:
    """Return the response of what is 0 at rest and swept, in the units in which it was measured.

    gain: of the sensor. in_time: whether its start is known, so that it may show a lag. Raises
    IdentificationError if there are too few frequencies.
    """
    scale = largest_response(measured)
    scaled = replace(measured, H=measured.H / scale)
    found, resonance_hz = _regressed(scaled, NOTHING, None, swept=True)
    lag, sd = float(found.mean[1]), float(np.sqrt(found.covariance[1, 1]))
    # of log evidence, that a lag brings (the ratio of Savage and Dickey)
    if not in_time or 0.5 * (lag / sd) ** 2 - np.log(LAG_SD / sd) < LEAST_GAIN:
        found, resonance_hz = _regressed(scaled, NOTHING, found.prior, 0.0, swept=True)
    G = _response(found, 0.0, float(found.mean[1]) * scale / gain, scale / gain)
    return Fit(G, gain, 0.0, resonance_hz, found.prior.modes)


def _response(found: Posterior, rest: float, lag: float, scale: float) -> ImpulseResponse:
    """Return the response, as far as it is loud, and what is not known of it."""
    k = np.arange(-BEFORE, LONGEST, dtype=float)
    q = found.response(k)
    loud = int(np.flatnonzero(np.abs(q) >= SILENT * np.abs(q).max())[-1]) + 1
    unknown = _unknown(found.known(k[:loud]) * scale**2)
    return ImpulseResponse(scale * q[:loud], BEFORE, rest, lag, unknown=unknown)


def _regressed(
    measured: FrequencyResponse, sensor: tuple[float, float], prior: Prior | None,
    lag_sd: float = LAG_SD, swept: bool = False,
) -> tuple[Posterior, float]:  # fmt: skip
    """Return the posterior of (g − ĝ, g·lag, g·q), and where its mean is greatest, Hz."""
    largest_response(measured)
    linear, H, power = _Linear(measured, sensor[0], max(lag_sd, NONE)), measured.H, measured.power
    least = power * (np.abs(H) ** 2 + 1.0) / measured.averages
    own = np.maximum(power * (measured.noise * np.abs(H)) ** 2, LEAST_NOISE**2 * least)
    left = np.zeros(len(H))
    sought = prior is None and bool((own > NOISE**2 * least).any())
    for noise in (NOISE**2 * least, own, own):
        weight = np.sqrt(2.0 * power / _smoothed(noise + left, measured.hz))
        data = linear.data(weight, sensor[1])
        found = regress(data, prior)
        if sought and prior is not None:  # what looked like modes at first may be noise
            again, sought = regress(data), False
            found = again if again.cost < found.cost - LEAST_GAIN else found
        prior, modelled = found.prior, linear.modelled(found)
        # what no linear model explains counts as noise, which in a sweep does not average out
        if noise is own or not swept:
            left = power * np.abs(H - modelled) ** 2 / (1.0 if swept else measured.averages)
    return found, float(measured.hz[np.argmax(np.abs(modelled))])


class _Linear:
    """A measured response as a linear function of (g − ĝ, g·lag, g·q) and of what modes add."""

    def __init__(self, measured: FrequencyResponse, gain: float, lag_sd: float) -> None:
        self._k = np.arange(-BEFORE, AFTER, dtype=float)
        self._z: Complex = np.exp(2j * np.pi * TS * measured.hz)
        self._H, self._gain, self._lag_sd = measured.H, gain, lag_sd
        self._acceleration = self._z - 2.0 + 1.0 / self._z
        q = self._acceleration[:, None] * self._z[:, None] ** -self._k
        self._columns = np.column_stack([np.ones(len(self._z)), 1.0 / self._z - 1.0, q])

    def data(self, weight: Array, gain_sd: float) -> Data:
        """Return the data of a regression, for 1 / noise (k,)."""

        def by_modes(modes: Sequence[Mode], onset: int) -> Array:
            return rows(weight, self._ringing(modes, onset))

        X, y = rows(weight, self._columns), rows(weight, self._H - self._gain)
        return Data.of(X, y, self._k, np.array([gain_sd, self._lag_sd]) ** -2.0, by_modes)

    def modelled(self, found: Posterior) -> Complex:
        """Return the mean of the response (k,)."""
        ringing = self._ringing(found.prior.modes, found.prior.onset)
        columns = np.hstack([self._columns, ringing])
        return np.asarray(self._gain + columns @ found.mean.astype(complex))

    def _ringing(self, modes: Sequence[Mode], onset: int) -> Complex:
        return np.asarray(self._acceleration[:, None] * transfer(self._z, modes, onset))


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
