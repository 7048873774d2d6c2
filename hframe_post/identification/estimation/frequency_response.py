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
from scipy import linalg, signal

from hframe_post.arrays import TS, Array, Complex, Flags
from hframe_post.errors import IdentificationError

SEGMENT = 16000  # samples; bias 0.4 % at the peak of a resonance at 20 Hz with damping 0.03
SHORTEST = 4000  # samples of a record
OVERLAP = 7 / 8
BANDWIDTH = 2.08  # bins of a Hann window: independent estimates per segment length
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

    def corrected(self, gain: float = 1.0, late: float = 0.0) -> FrequencyResponse:
        """Return the response without a sensor's gain, as if it had begun ``late`` s later."""
        return replace(self, H=self.H * np.exp(2j * np.pi * self.hz * late) / gain)

    @property
    def noise(self) -> Array:
        """Return the RMS of |ΔH| / |H| (k,) for the coherence γ²: √((1 − γ²) / (γ² averages))."""
        gamma = np.clip(self.coherence, 1e-9, 1.0)
        return np.sqrt((1.0 - gamma) / (gamma * self.averages))


@dataclass(frozen=True, slots=True)
class Spectra:
    """Cross spectra P (f, k + m, k + m), [i, j]: conj(j)·i, of k commands and what m axes show."""

    hz: Array
    P: Complex
    commands: int
    averages: float

    @classmethod
    def of(cls, u: Array, y: Array, segment: int = SEGMENT) -> Spectra:
        """Return the spectra of u (n, k) and y (n, m) at 1 kHz, at rest at both ends.

        Frequencies are two bins apart: with a Hann window those between add nothing. Raises
        IdentificationError for a record that is too short or zero throughout.
        """
        if len(u) < SHORTEST:
            raise IdentificationError(
                f"the run lasts {len(u)} ms, too short; it must last {SHORTEST} ms"
            )
        if not u.any() or not y.any():
            what = "response" if u.any() else "command"
            raise IdentificationError(f"the {what} is zero throughout")
        segment = min(segment, len(u) // 2)
        padded = np.pad(np.hstack([u, y]), ((segment, segment), (0, 0))).T
        options = {
            "fs": 1.0 / TS, "window": "hann", "nperseg": segment,
            "noverlap": int(OVERLAP * segment), "detrend": False,
        }  # fmt: skip
        hz, spectra = signal.csd(padded[None, :, :], padded[:, None, :], **options)
        kept, averages = slice(2, None, 2), BANDWIDTH * len(u) / segment
        return cls(hz[kept], np.moveaxis(spectra, -1, 0)[kept], u.shape[1], averages)

    def along(self, axes: Array) -> Spectra:
        """Return what axes (j, m) of those that show something show."""
        turned = linalg.block_diag(np.eye(self.commands), axes)
        return replace(self, P=turned @ self.P @ turned.T)

    def responses(self, band_hz: tuple[float, float]) -> list[list[FrequencyResponse]]:
        """Return what each of the commands does to each axis, within a band."""
        k, P = self.commands, self.P
        P_uu, P_yu, P_yy = P[:, :k, :k], P[:, k:, :k], P[:, k:, k:]
        least = TINY + 1e-12 * np.trace(P_uu, axis1=1, axis2=2).real.max()
        inverse = np.linalg.inv(P_uu + least * np.eye(k))
        H = P_yu @ inverse
        noise = np.einsum("fii->fi", P_yy - H @ P_yu.conj().transpose(0, 2, 1)).real
        power = 1.0 / np.maximum(np.einsum("fii->fi", inverse).real, TINY)
        shown = np.abs(H) ** 2 * power[:, None, :]
        coherence = shown / np.maximum(shown + np.maximum(noise[:, :, None], 0.0), TINY)
        return [
            [
                FrequencyResponse(
                    self.hz, H[:, i, j], coherence[:, i, j], power[:, j], self.averages
                ).within(band_hz)
                for i in range(H.shape[1])
            ]
            for j in range(k)
        ]


def average(responses: Sequence[FrequencyResponse]) -> FrequencyResponse:
    """Return the mean of several runs, each weighted with its signal over its noise, γ²/(1 − γ²).

    The coherence of the mean is that of the runs taken together: it falls where they differ.
    """
    first = responses[0].hz
    if any(not np.array_equal(first, r.hz) for r in responses):
        raise IdentificationError(
            "runs differ in their frequencies; they must come from the same sweep"
        )
    H, gamma = (np.array([getattr(r, name) for r in responses]) for name in ("H", "coherence"))
    averages = np.array([[r.averages] for r in responses])
    w = averages * np.maximum(gamma, 1e-12) / np.maximum(1.0 - gamma, 1e-9)
    mean = (w * H).sum(0) / w.sum(0)
    output = (w * np.abs(H) ** 2 / np.maximum(gamma, 1e-12)).sum(0) / w.sum(0)
    coherence = np.minimum(np.abs(mean) ** 2 / np.maximum(output, TINY), 1.0)
    power = np.mean([r.power for r in responses], axis=0)
    return FrequencyResponse(first, mean, coherence, power, float(averages.sum()))


def spread(responses: Sequence[FrequencyResponse]) -> float:
    """Return the RMS deviation of the responses from their mean, relative to it.

    Weighted with input power times coherence. 0.1 means that the plant changes by 10 %.
    """
    w = np.array([r.power * r.coherence for r in responses])
    H = np.array([r.H for r in responses])
    mean = (w * H).sum(0) / np.maximum(w.sum(0), TINY)
    size = (w * np.abs(mean) ** 2).sum()
    return float(np.sqrt((w * np.abs(H - mean) ** 2).sum() / size)) if size else 0.0


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


def largest_response(part: FrequencyResponse) -> float:
    """Return the largest |H|; raise IdentificationError if too little was measured."""
    if len(part.hz) < 50:
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
