"""Frequency responses from samples at 1 ms: Welch's method, averages over runs, their spread.

==============  ===============================================================
``P_uu, P_yy``  power spectra of input and output
``P_uy``        cross spectrum, conj(U)·Y
``H1, H2``      P_uy / P_uu (noise in the output), P_yy / P_yu (in the input)
``Hv``          geometric mean of both (as much noise in one as in the other)
``coherence``   |P_uy|² / (P_uu P_yy), the share of the output that the input explains
==============  ===============================================================

The record is at rest at both ends and padded with rest, so a segment cuts no response off:
what is left of leakage is that H is smoothed over the width of the window's spectrum. For a
Hann window of T seconds at a resonance of damping ζ and frequency f the bias is about
1 / (3 (T ζ f)²) at its peak.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy import signal

from hframe_post.arrays import Array, Complex
from hframe_post.errors import IdentificationError

RATE_HZ = 1000.0
SEGMENT = 16000  # samples; bias 0.4 % at the peak of a resonance at 20 Hz with damping 0.03
SHORTEST = 4000  # samples of a record
OVERLAP = 7 / 8
BANDWIDTH = 2.08  # bins, of the Hann window: independent estimates a segment's length
CERTAIN = 1e-4  # of noise that is assumed at the least when runs are weighted

Method = Literal["H1", "H2", "Hv"]


@dataclass(frozen=True)
class FrequencyResponse:
    """H (k,) complex at ``hz`` (k,) ascending, with coherence (k,) and input power (k,) per Hz.

    averages: independent estimates in each value, of which ``noise`` is told.
    """

    hz: Array
    H: Complex
    coherence: Array
    power: Array
    averages: float = 1.0

    def within(self, band_hz: tuple[float, float]) -> FrequencyResponse:
        """The part from ``band_hz[0]`` to ``band_hz[1]``, both included."""
        kept = (self.hz >= band_hz[0]) & (self.hz <= band_hz[1])
        return FrequencyResponse(
            self.hz[kept], self.H[kept], self.coherence[kept], self.power[kept], self.averages
        )

    @property
    def noise(self) -> Array:
        """RMS of |ΔH| / |H| (k,) that the coherence γ² tells: √((1 − γ²) / (γ² averages))."""
        gamma = np.clip(self.coherence, 1e-9, 1.0)
        return np.sqrt((1.0 - gamma) / (gamma * self.averages))


def estimate(u: Array, y: Array, method: Method = "H1") -> FrequencyResponse:
    """The response of y (n,) to u (n,), both at 1 kHz, at rest at both ends and without offset.

    Frequencies are two bins apart: with a Hann window those between tell nothing new.
    Raises IdentificationError where the record is too short, silent or not finite.
    """
    n = len(u)
    if len(y) != n:
        raise IdentificationError(f"command and response differ in length: {n} and {len(y)}")
    if n < SHORTEST:
        raise IdentificationError(f"{n} ms are too short; {SHORTEST} ms are the least")
    if not (np.isfinite(u).all() and np.isfinite(y).all()):
        raise IdentificationError("command or response has values that are not finite")
    if not u.any() or not y.any():
        raise IdentificationError(f"the {'response' if u.any() else 'command'} is zero throughout")
    segment = min(SEGMENT, n // 2)
    options = {
        "fs": RATE_HZ,
        "window": "hann",
        "nperseg": segment,
        "noverlap": int(OVERLAP * segment),
        "detrend": False,
    }
    u, y = np.pad(u, segment), np.pad(y, segment)
    hz, P_uy = signal.csd(u, y, **options)
    P_uu, P_yy = (signal.welch(one, **options)[1] for one in (u, y))
    kept = slice(2, None, 2)
    hz, P_uy, P_uu, P_yy = hz[kept], P_uy[kept], P_uu[kept], P_yy[kept]
    tiny = np.finfo(float).tiny
    cross = np.abs(P_uy)
    coherence = np.minimum(cross**2 / np.maximum(P_uu * P_yy, tiny), 1.0)
    size = {
        "H1": cross / np.maximum(P_uu, tiny),
        "H2": P_yy / np.maximum(cross, tiny),
        "Hv": np.sqrt(P_yy / np.maximum(P_uu, tiny)),
    }[method]
    H = size * np.exp(1j * np.angle(P_uy))
    return FrequencyResponse(hz, H, coherence, P_uu, BANDWIDTH * n / segment)


def average(responses: Sequence[FrequencyResponse]) -> FrequencyResponse:
    """One response of several runs, each weighted with γ²/(1 − γ²), its signal over its noise.

    The coherence of the mean is that of the runs taken together: it falls where they differ.
    """
    _same(responses)
    H, gamma = (np.array([getattr(r, name) for r in responses]) for name in ("H", "coherence"))
    averages = np.array([[r.averages] for r in responses])
    w = averages * np.maximum(gamma, 1e-12) / (1.0 - gamma + CERTAIN)
    mean = (w * H).sum(0) / w.sum(0)
    output = (w * np.abs(H) ** 2 / np.maximum(gamma, 1e-12)).sum(0) / w.sum(0)
    coherence = np.minimum(np.abs(mean) ** 2 / np.maximum(output, np.finfo(float).tiny), 1.0)
    power = np.mean([r.power for r in responses], axis=0)
    return FrequencyResponse(responses[0].hz, mean, coherence, power, float(averages.sum()))


def spread(responses: Sequence[FrequencyResponse], band_hz: tuple[float, float]) -> float:
    """RMS deviation of the responses from their mean, relative to it, over ``band_hz``.

    Weighted with input power times coherence. 0.1: the plant changes by 10 % between them.
    """
    _same(responses)
    parts = [r.within(band_hz) for r in responses]
    if not len(parts[0].hz):
        raise IdentificationError(f"no frequency lies in {band_hz[0]:g}–{band_hz[1]:g} Hz")
    w = np.array([r.power * r.coherence for r in parts])
    H = np.array([r.H for r in parts])
    total = np.maximum(w.sum(0), np.finfo(float).tiny)
    mean = (w * H).sum(0) / total
    size = (w * np.abs(mean) ** 2).sum()
    return float(np.sqrt((w * np.abs(H - mean) ** 2).sum() / size)) if size else 0.0


def _same(responses: Sequence[FrequencyResponse]) -> None:
    if not responses:
        raise IdentificationError("no run to average")
    first = responses[0].hz
    if any(not np.array_equal(first, r.hz) for r in responses):
        raise IdentificationError(
            "runs differ in their frequencies; they must come from the same sweep"
        )


ROUNDS = 3  # the mean, from which delays are counted, sharpens with each


def delays(responses: Sequence[FrequencyResponse]) -> Array:
    """How late each is, (n,) in s, from their mean; the delays' own mean is 0.

    Of least squares over the phase, each frequency weighted with what is coherent of it.
    """
    late = np.zeros(len(responses))
    for _ in range(ROUNDS if len(responses) > 1 else 0):
        mean = average([advanced(r, by) for r, by in zip(responses, late, strict=True)])
        omega = 2.0 * np.pi * mean.hz
        for k, response in enumerate(responses):
            turned = np.angle(response.H * np.exp(1j * omega * late[k]) * mean.H.conj())
            weight = response.power * response.coherence * np.abs(mean.H) ** 2
            late[k] -= (weight * omega * turned).sum() / (weight * omega**2).sum()
        late -= late.mean()
    return late


def advanced(response: FrequencyResponse, seconds: float) -> FrequencyResponse:
    """The response as it would be had the recording begun ``seconds`` later."""
    return replace(response, H=response.H * np.exp(2j * np.pi * response.hz * seconds))
