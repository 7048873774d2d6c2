"""The response of an axis from recordings that tell when the motion began.

    H(f) = g·G(f) + e,   G = 1 − lag·(1 − 1/z) + (z − 2 + 1/z)·Q(z)

is linear in g, g·lag and g·q: ordinary regression, with a kernel for q (``regression``).
What no linear model explains counts as noise, whose power by frequency is that of what is left
(the best linear approximation; Pintelon, Schoukens, System Identification, 2012).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.fft import irfft, rfft
from scipy.ndimage import uniform_filter1d

from hframe_post.arrays import TS, Array, Complex
from hframe_post.errors import IdentificationError
from hframe_post.identification.estimation.estimated import Estimated
from hframe_post.identification.estimation.kernel import Mode, transfer
from hframe_post.identification.estimation.regression import Data, Posterior, regress
from hframe_post.identification.responses.frequency_response import SENSOR, FrequencyResponse
from hframe_post.model.impulse_response import ImpulseResponse

BEFORE = 4  # samples of q before the command, since it is band-limited
AFTER = 436  # samples in which it decays; modes may ring for longer
LONGEST = 1900  # samples of q
SILENT = 2e-3  # of the largest q
NOISE_HZ = 4.0  # over which the noise is alike
NOISE = 0.1  # share of the response that counts as noise at first
LEAST_NOISE = 2e-3  # and at least
ROUNDS = 3  # in which the noise is found
LAG_SD = 10.0  # samples
LEAST_FREQUENCIES = 50
UNKNOWN = 64  # samples of the filter that holds the uncertainty
FINE = 4096


def estimated(measured: FrequencyResponse, sensor: tuple[float, float] = SENSOR) -> Estimated:
    """Return the response of an axis that was measured, with what is not known of it.

    All delay is the printer's. sensor: mean and standard deviation of its gain. Raises
    IdentificationError if there are too few frequencies.
    """
    hz = measured.hz
    if len(hz) < LEAST_FREQUENCIES:
        raise IdentificationError(f"only {len(hz)} frequencies were excited, too few for a model")
    found, modelled = _regressed(measured, sensor)
    gain = float(sensor[0] + found.mean[0])
    k = np.arange(-BEFORE, LONGEST, dtype=float)
    q = found.response(k)
    last = int(np.flatnonzero(np.abs(q) > SILENT * np.abs(q).max())[-1]) + 1
    unknown = _unknown(found.known(k[:last]) / gain**2)
    G = ImpulseResponse(q[:last] / gain, BEFORE, lag=float(found.mean[1] / gain), unknown=unknown)
    strongest = float(hz[np.argmax(np.abs(modelled))])
    return Estimated(G, gain, 0.0, strongest, found.prior)


def _regressed(
    measured: FrequencyResponse, sensor: tuple[float, float]
) -> tuple[Posterior, Complex]:
    """Return the posterior of (g − ĝ, g·lag, g·q), with the noise that it leaves, and its mean."""
    k = np.arange(-BEFORE, AFTER, dtype=float)
    hz, H, power = measured.hz, measured.H, measured.power
    z: Complex = np.exp(2j * np.pi * TS * hz)
    twice = z - 2.0 + 1.0 / z
    X = np.column_stack([np.ones(len(hz)), 1.0 / z - 1.0, twice[:, None] * z[:, None] ** -k])
    precision = np.array([sensor[1] ** -2.0, LAG_SD**-2.0])
    output = power * np.abs(H) ** 2 / np.clip(measured.coherence, 1e-9, 1.0)
    noise, prior = NOISE**2 * output, None
    for _ in range(ROUNDS):
        weight = np.sqrt(2.0 * measured.averages * power / _smoothed(noise, hz, output))

        def rows(columns: Complex, weight: Array = weight) -> Array:
            weighted = (weight * columns.T).T
            return np.concatenate([weighted.real, weighted.imag])

        def by_modes(modes: Sequence[Mode], onset: int) -> Array:
            return rows(twice[:, None] * transfer(z, modes, onset))

        posterior = regress(Data(rows(X), rows(H - sensor[0]), k, precision, by_modes), prior)
        prior = posterior.prior
        columns = np.hstack([X, twice[:, None] * transfer(z, prior.modes, prior.onset)])
        modelled = sensor[0] + columns @ posterior.mean.astype(complex)
        noise = output - power * (2.0 * (modelled.conj() * H).real - np.abs(modelled) ** 2)
    return posterior, modelled


def _smoothed(noise: Array, hz: Array, output: Array) -> Array:
    """Return the power of the noise (k,), alike over NOISE_HZ."""
    bins = max(int(NOISE_HZ / (hz[1] - hz[0])), 1)
    least = LEAST_NOISE**2 * uniform_filter1d(output, bins, mode="nearest")
    return np.asarray(np.maximum(uniform_filter1d(noise, bins, mode="nearest"), least))


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
