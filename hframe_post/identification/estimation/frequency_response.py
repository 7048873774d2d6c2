"""Frequency responses from samples at 1 ms, by Welch's method.

With the spectra of the commands u and of what the sensor shows, y,

    H = P_yu P_uu⁻¹,   noise = P_yy − H P_uu Hᴴ,   var H_ij = noise_i · (P_uu⁻¹)_jj

(Bendat, Piersol, Random Data, 2010, chapter 7). All noise is in the output, and 1 / (P_uu⁻¹)_jj is
the power of a command that no other one explains. The coherence is the share of the output that
this command explains.

The record is at rest at both ends and padded with rest, so no segment cuts a response off. The
remaining leakage smooths H over the width of the window's spectrum: for a Hann window of T
seconds, a resonance of damping ζ and frequency f is about 1 / (3 (T ζ f)²) too low at its peak.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy import signal
from scipy.fft import rfft, rfftfreq

from hframe_post.arrays import Array, Complex, Flags
from hframe_post.errors import IdentificationError

RATE_HZ = 1000.0
SEGMENT = 16000  # samples; bias 0.4 % at the peak of a resonance at 20 Hz with damping 0.03
SHORTEST = 4000  # samples of a record
OVERLAP = 7 / 8
BANDWIDTH = 2.08  # bins of a Hann window: independent estimates per segment length
LEAST_NOISE = 1e-4  # power, assumed at least when runs are weighted
TINY = np.finfo(float).tiny


@dataclass(frozen=True)
class FrequencyResponse:
    """H (k,) complex at ``hz`` (k,) ascending, with coherence (k,) and input power (k,) per Hz.

    averages: number of independent estimates in each value, from which ``noise`` follows.
    """

    hz: Array
    H: Complex
    coherence: Array
    power: Array
    averages: float = 1.0

    def within(self, band_hz: tuple[float, float]) -> FrequencyResponse:
        """Return the part from ``band_hz[0]`` to ``band_hz[1]``, both included."""
        return self.where((self.hz >= band_hz[0]) & (self.hz <= band_hz[1]))

    def where(self, kept: Flags) -> FrequencyResponse:
        """Return the part at the frequencies that are flagged (k,)."""
        return FrequencyResponse(
            self.hz[kept], self.H[kept], self.coherence[kept], self.power[kept], self.averages
        )

    @property
    def noise(self) -> Array:
        """Return the RMS of |ΔH| / |H| (k,) for the coherence γ²: √((1 − γ²) / (γ² averages))."""
        gamma = np.clip(self.coherence, 1e-9, 1.0)
        return np.sqrt((1.0 - gamma) / (gamma * self.averages))


def estimate(u: Array, y: Array) -> FrequencyResponse:
    """Return the response of y (n,) to u (n,), both at 1 kHz, at rest at both ends, without offset.

    Frequencies are two bins apart: with a Hann window those between add nothing. Raises
    IdentificationError if the record is too short, zero throughout or not finite.
    """
    n = len(u)
    if len(y) != n:
        raise IdentificationError(f"command and response differ in length: {n} and {len(y)}")
    if n < SHORTEST:
        raise IdentificationError(f"the run lasts {n} ms, too short; it must last {SHORTEST} ms")
    if not (np.isfinite(u).all() and np.isfinite(y).all()):
        raise IdentificationError("command or response has values that are not finite")
    if not u.any() or not y.any():
        raise IdentificationError(f"the {'response' if u.any() else 'command'} is zero throughout")
    return by_command(u[:, None], y[:, None])[0][0]


def by_command(u: Array, y: Array, segment: int = SEGMENT) -> list[list[FrequencyResponse]]:
    """Return what each of the commands u (n, k) does to each of y (n, m), at 1 kHz."""
    k, segment = u.shape[1], min(segment, len(u) // 2)
    hz, P = _spectra(np.hstack([u, y]), segment)
    averages = BANDWIDTH * len(u) / segment
    P_uu, P_yu, P_yy = P[:, :k, :k], P[:, k:, :k], P[:, k:, k:]
    least = TINY + 1e-12 * np.trace(P_uu, axis1=1, axis2=2).real.max()
    inverse = np.linalg.inv(P_uu + least * np.eye(k))
    H = P_yu @ inverse
    noise = np.einsum("fii->fi", P_yy - H @ P_yu.conj().transpose(0, 2, 1)).real
    found: list[list[FrequencyResponse]] = []
    for j in range(k):
        power = 1.0 / np.maximum(inverse[:, j, j].real, TINY)
        found.append([])
        for i in range(y.shape[1]):
            shown = np.abs(H[:, i, j]) ** 2 * power
            coherence = shown / np.maximum(shown + np.maximum(noise[:, i], 0.0), TINY)
            found[-1].append(FrequencyResponse(hz, H[:, i, j], coherence, power, averages))
    return found


def _spectra(values: Array, segment: int) -> tuple[Array, Complex]:
    """Return frequencies (f,) and cross spectra (f, k, k), [i, j]: conj(j)·i, of values (n, k)."""
    padded = np.pad(values, ((segment, segment), (0, 0))).T
    options = {
        "fs": RATE_HZ, "window": "hann", "nperseg": segment,
        "noverlap": int(OVERLAP * segment), "detrend": False,
    }  # fmt: skip
    hz, spectra = signal.csd(padded[None, :, :], padded[:, None, :], **options)
    kept = slice(2, None, 2)  # those between add nothing, with a Hann window
    return hz[kept], np.moveaxis(spectra, -1, 0)[kept]


def whole_record(u: Array, y: Array, noise: float) -> FrequencyResponse:
    """Return the response of y (n,) to u (n,) at 1 kHz, from the spectra of the whole record.

    For a single short chirp, which has no parts to average: nothing leaks, but each frequency has
    all its noise. noise: RMS of y at rest.
    """
    U, Y = rfft(u), rfft(y)
    power = np.abs(U) ** 2
    coherence = 1.0 / (1.0 + len(u) * noise**2 / np.maximum(np.abs(Y) ** 2, TINY))
    hz, H = rfftfreq(len(u), 1.0 / RATE_HZ), Y / np.where(power > 0.0, U, 1.0)
    return FrequencyResponse(hz[1:], H[1:], coherence[1:], power[1:])


def average(responses: Sequence[FrequencyResponse]) -> FrequencyResponse:
    """Return the mean of several runs, each weighted with its signal over its noise, γ²/(1 − γ²).

    The coherence of the mean is that of the runs taken together: it falls where they differ.
    """
    check_same_frequencies(responses)
    H, gamma = (np.array([getattr(r, name) for r in responses]) for name in ("H", "coherence"))
    averages = np.array([[r.averages] for r in responses])
    w = averages * np.maximum(gamma, 1e-12) / (1.0 - gamma + LEAST_NOISE)
    mean = (w * H).sum(0) / w.sum(0)
    output = (w * np.abs(H) ** 2 / np.maximum(gamma, 1e-12)).sum(0) / w.sum(0)
    coherence = np.minimum(np.abs(mean) ** 2 / np.maximum(output, TINY), 1.0)
    power = np.mean([r.power for r in responses], axis=0)
    return FrequencyResponse(responses[0].hz, mean, coherence, power, float(averages.sum()))


def spread(responses: Sequence[FrequencyResponse], band_hz: tuple[float, float]) -> float:
    """Return the RMS deviation of the responses from their mean, relative to it, over ``band_hz``.

    Weighted with input power times coherence. 0.1 means that the plant changes by 10 %.
    """
    check_same_frequencies(responses)
    parts = [r.within(band_hz) for r in responses]
    if not len(parts[0].hz):
        raise IdentificationError(f"no frequency lies in {band_hz[0]:g}–{band_hz[1]:g} Hz")
    w = np.array([r.power * r.coherence for r in parts])
    H = np.array([r.H for r in parts])
    mean = (w * H).sum(0) / np.maximum(w.sum(0), TINY)
    size = (w * np.abs(mean) ** 2).sum()
    return float(np.sqrt((w * np.abs(H - mean) ** 2).sum() / size)) if size else 0.0


def check_same_frequencies(responses: Sequence[FrequencyResponse]) -> None:
    if not responses:
        raise IdentificationError("no run to average")
    first = responses[0].hz
    if any(not np.array_equal(first, r.hz) for r in responses):
        raise IdentificationError(
            "runs differ in their frequencies; they must come from the same sweep"
        )


def advanced(response: FrequencyResponse, seconds: float) -> FrequencyResponse:
    """Return the response as if the recording had begun ``seconds`` later."""
    return replace(response, H=response.H * np.exp(2j * np.pi * response.hz * seconds))


def share_left(H: Complex, response: FrequencyResponse, weight: Array) -> float:
    """Return the share of a measured response that H (k,) leaves, whatever their gain and delay."""
    cross = weight * response.H * H.conj()
    most = float(np.abs((_turned(response.hz.tobytes()) @ cross).real).max())
    sizes = (weight * np.abs(H) ** 2).sum() * (weight * np.abs(response.H) ** 2).sum()
    return float(np.sqrt(max(1.0 - most**2 / float(sizes), 0.0)))


@lru_cache(maxsize=1)
def _turned(hz: bytes) -> Complex:
    """Return what delays (d,) of ± 5 ms turn frequencies (k,) by, (d, k): often the same ones."""
    late = np.linspace(-5e-3, 5e-3, 201)
    return np.asarray(np.exp(2j * np.pi * np.outer(late, np.frombuffer(hz))))


def lowest(x: Array, costs: Sequence[float]) -> float:
    """Return the x (n,), evenly spaced, of the lowest cost, by a parabola through three."""
    k = int(np.clip(np.argmin(costs), 1, len(x) - 2))
    before, here, after = costs[k - 1 : k + 2]
    curve = before - 2.0 * here + after
    step = float(np.clip(0.5 * (before - after) / curve, -1.0, 1.0)) if curve > 0.0 else 0.0
    return float(x[k] + step * (x[1] - x[0]))


# ---------------------------------------------------------------------- noise

LEAST_FREQUENCIES = 50  # of a model
SENSOR = (1.0, 0.03)  # gain of a sensor, as mean and standard deviation


def largest_response(part: FrequencyResponse) -> float:
    """Return the largest |H|; raise IdentificationError if too little was measured."""
    if len(part.hz) < LEAST_FREQUENCIES:
        raise IdentificationError(
            f"only {len(part.hz)} frequencies were excited, too few for a model"
        )
    if not (np.isfinite(part.H).all() and np.isfinite(part.coherence).all()):
        raise IdentificationError("the frequency response has values that are not finite")
    largest = float(np.abs(part.H).max(initial=0.0))
    if largest == 0.0 or not (part.power * part.coherence).any():
        raise IdentificationError("the frequency response or its coherence is zero in the band")
    return largest


def weights(part: FrequencyResponse) -> Array:
    """Return one over the standard deviation of H, (k,).

    The standard deviation is at least 0.3 % of the largest |H|.
    Frequencies that the sweep hardly excites get 0. Raises IdentificationError without a signal.
    """
    largest = largest_response(part)
    sd = np.hypot(part.noise * np.abs(part.H), 0.003 * largest)
    return np.asarray((part.power > 1e-3 * np.median(part.power)) / sd)
