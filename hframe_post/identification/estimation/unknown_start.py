"""The impulse response of an axis, from recordings whose start and gain are unknown.

A real printer is not a sum of a few modes. Its response h is therefore estimated as it is, by least
squares with a prior (Pillonetto, Chen, Ljung, Regularized System Identification, 2022)

    ĥ = argmin Σ_f W(f) |H(f) − Σ_k h_k e^{−2πifk}|² + (h − δ)ᵀ K⁻¹ (h − δ)

H is the measured response, W the command's power over the power that no linear model explains,
and the kernel K that of ``regression``: h decays, and neighbouring samples are alike.

Such recordings do not tell the phase below the resonances, since nobody knows when the motion
began. There the printer is taken to do what its strongest mode alone does, 1/(1 − (f/f₀)²): from
ASSUMED[0]·f₀ down, and up to ASSUMED[1]·f₀ less and less. The result is written as what
acceleration does to the nozzle (``ImpulseResponse``), so that its gain at rest is exact.
"""

from __future__ import annotations

import numpy as np

from hframe_post.arrays import TS, Array, Complex
from hframe_post.errors import IdentificationError
from hframe_post.identification.estimation.frequency_response import (
    BANDWIDTH,
    FrequencyResponse,
    largest_response,
)
from hframe_post.identification.estimation.regression import (
    Data,
    Decay,
    Fit,
    Prior,
    posterior,
    rows,
)
from hframe_post.model.impulse_response import ImpulseResponse

AFTER, BEFORE = 400, 12  # samples of h; band-limited, it begins before the command
UNEXPLAINED = 0.25  # share of the response that counts as noise, since no linear model explains it
SIZE, BETA, ALPHA = 0.06, 0.0151, 0.1054  # of the kernel of h, and of the result's
ASSUMED = (0.25, 0.42)  # of f₀: one ideal mode below, the measurement above
IDEAL_SD = 0.003  # of that mode, up to MEASURED·f₀
MEASURED = 1.0 / 3.0  # of f₀, from which on the measurement counts
STRONGEST_HZ = (18.0, 95.0)  # in which f₀ is sought
LEAD, LENGTH = 32, 440  # samples of the result
FIT_HZ = 125.0, 0.25  # up to which, and how densely, the result is fitted
SLOW_HZ = 5.0  # of strokes as long as a bed
FIT_WEIGHT = 3000.0  # of the result against its kernel


def estimated(measured: FrequencyResponse) -> Fit:
    """Return the response that was measured where it was excited.

    Raises IdentificationError if there are too few frequencies.
    """
    hz = measured.hz
    largest_response(measured)
    f0 = _strongest(measured)
    gain, delay = gain_and_delay(measured)
    in_time = measured.H / gain * np.exp(2j * np.pi * hz * delay)
    h = _estimate(measured, in_time, f0)
    return Fit(_handed_over(h, f0), gain, delay, f0)


def _strongest(measured: FrequencyResponse) -> float:
    """Return the frequency of the strongest mode, Hz."""
    hz = measured.hz
    near = (hz >= STRONGEST_HZ[0]) & (hz <= STRONGEST_HZ[1])
    return float(hz[np.argmax(np.where(near, np.abs(measured.H), 0.0))])


def gain_and_delay(measured: FrequencyResponse) -> tuple[float, float]:
    """Return the gain and delay (s) with which one ideal mode is seen below the resonance."""
    hz, f0 = measured.hz, _strongest(measured)
    low = (hz >= f0 / 5.0) & (hz <= f0 / 2.4)
    H, omega = measured.H[low], 2.0 * np.pi * hz[low]
    if not low.any():
        raise IdentificationError(
            f"nothing was excited between {f0 / 5.0:.0f} and {f0 / 2.4:.0f} Hz, below the "
            f"resonance at {f0:.0f} Hz: begin the test at a lower frequency"
        )
    sign = np.sign(H.sum().real) or 1.0
    gain = float(sign * np.median(np.abs(H) * np.abs(1.0 - (hz[low] / f0) ** 2)))
    phase = np.unwrap(np.angle(H / gain))
    return gain, float(-(omega @ phase) / (omega @ omega))


def _estimate(measured: FrequencyResponse, H: Complex, f0: float) -> Array:
    """Return ĥ − δ (BEFORE + AFTER,) from sample −BEFORE on."""
    hz, k = measured.hz, np.arange(-BEFORE, AFTER, dtype=float)
    counts = hz >= MEASURED * f0
    low = np.arange(0.0, MEASURED * f0, 0.5)
    power = measured.power[counts] / (measured.power[counts] @ np.abs(H[counts]) ** 2)
    step = float(np.median(np.diff(hz)))
    samples = measured.averages * 2.0 / (BANDWIDTH * step * TS)
    by_noise = np.sqrt(samples * power) / UNEXPLAINED
    weight = np.concatenate([np.full(len(low), 1.0 / IDEAL_SD), by_noise])
    wanted = np.concatenate([_one_mode(low, f0), H[counts]]) - 1.0
    turn = _turn(np.concatenate([low, hz[counts]]), k)
    return posterior(Data.of(rows(weight, turn), rows(weight, wanted), k), _prior(SIZE)).mean


def _handed_over(h: Array, f0: float) -> ImpulseResponse:
    """Return h − δ as what acceleration does, with one ideal mode where the phase is unknown."""
    hz = np.arange(FIT_HZ[1], FIT_HZ[0], FIT_HZ[1])
    at = np.clip((hz / f0 - ASSUMED[0]) / (ASSUMED[1] - ASSUMED[0]), 0.0, 1.0)
    known = at * at * (3.0 - 2.0 * at)
    ideal = _one_mode(np.minimum(hz, 0.7 * f0), f0) - 1.0
    off = (1.0 - known) * ideal + known * (_turn(hz, np.arange(-BEFORE, AFTER, dtype=float)) @ h)
    k = np.arange(-LEAD, LENGTH - LEAD, dtype=float)
    slow = np.maximum(SLOW_HZ / hz, 1.0) ** 2  # acceleration is as strong there: all of Q counts
    weight = FIT_WEIGHT * slow / np.maximum(hz, SLOW_HZ) ** 1.5
    X = -((2.0 * np.sin(np.pi * TS * hz[:, None])) ** 2) * _turn(hz, k)
    data = Data.of(rows(weight, X), rows(weight, off), k)
    return ImpulseResponse(posterior(data, _prior(1.0 / (2.0 * np.pi * TS * f0))).mean, LEAD)


def _turn(hz: Array, k: Array) -> Complex:
    return np.asarray(np.exp(-2j * np.pi * TS * np.outer(hz, k)))


def _prior(size: float) -> Prior:
    return Prior(Decay(size, BETA, ALPHA))


def _one_mode(hz: Array, f0: float) -> Array:
    return np.asarray(1.0 / (1.0 - (hz / f0) ** 2))
