"""A response that was found, and the modes it rings in, for people.

What modes contribute follows from

    H(f) = e^{−sτ}·sinc²(f·Ts)·Σ (c_i + d_i p_i) / (p_i² + 2ζ_i p_i + 1),   p_i = s/ω_i,  s = 2πjf

with τ the delay of the recording; c and d are what a mode contributes, by position and by speed.
sinc² stands for the command, played as straight lines between samples of Ts. All but τ is linear.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from hframe_post.arrays import TS, Array, Complex
from hframe_post.identification.estimation.frequency_response import (
    FrequencyResponse,
    share_left,
    weights,
)
from hframe_post.identification.estimation.regression import Mode, Prior
from hframe_post.model.impulse_response import ImpulseResponse

LISTED = 0.03  # of the motion at rest: modes that contribute less are not listed
RINGS = 0.3  # damping ratio of a mode, above which nobody sees it ring
DELAYS: Array = np.linspace(-2e-3, 2e-3, 401)  # s from the lag to the delay of modes


@dataclass(frozen=True, slots=True)
class Fit:
    """A response G, without the sensor's gain and the delay (s) of the recording.

    gain_sd: standard deviation of the gain, or how far half of the frequencies are from it.
    resonance_hz: where |G| is greatest. prior: hyperparameters that the regression found, if there
    was one. residual: share of the measurement that is left, weighted with input power. modes: Hz
    and damping ratio of each that rings and counts, lowest first; of racking, none.
    """

    G: ImpulseResponse
    gain: float
    delay: float
    resonance_hz: float
    prior: Prior | None = None
    residual: float = 0.0
    modes: list[tuple[float, float]] = field(default_factory=list)
    gain_sd: float = 0.0

    @property
    def lag(self) -> float:
        """Return how late the printer is at a constant speed, s."""
        return self.G.lag * TS

    @property
    def ringing(self) -> list[Mode]:
        """Return the modes of the regression that ring."""
        return [mode for mode in self.prior.modes if mode.zeta < RINGS] if self.prior else []

    def response(self, hz: Array) -> Complex:
        """Return what the sensor shows at ``hz`` (k,), including gain and delay."""
        turned = np.exp(-2j * np.pi * hz * self.delay)
        return np.asarray(self.gain * turned * self.G.response(2.0 * np.pi * TS * hz))


def described(found: Fit, whole: FrequencyResponse, late: float) -> Fit:
    """Return the fit with the share that it leaves, and the modes that ring and count in the band.

    late: s, of the measurement, by recording and printer. Where the regression found no mode, it is
    the main resonance, whose height is 1/2ζ.
    """
    left = share_left(found.response(whole.hz), whole, whole.power)
    if modes := found.ringing:
        sizes, _ = shares(whole, modes, late, speed=True)
        counting = zip(modes, sizes.tolist(), strict=True)
        known = sorted((mode.hz, mode.zeta) for mode, size in counting if size > LISTED)
    else:
        peak = np.abs(np.interp(found.resonance_hz, whole.hz, np.abs(whole.H)) / found.gain)
        known = [(found.resonance_hz, float(0.5 / peak))]
    listed = [(hz, zeta) for hz, zeta in known if zeta < RINGS and hz <= whole.hz[-1]]
    return replace(found, residual=left, modes=listed)


def shares(
    measured: FrequencyResponse, modes: Sequence[Mode], late: float, speed: bool
) -> tuple[Array, float]:
    """Return what each mode contributes to the motion, (n,), and their delay in s.

    late: s, about that delay. speed: whether d is free; if it is not, all that is late, but for the
    delay, is so by damping.
    """
    s = np.asarray(2j * np.pi * TS * measured.hz)
    weight = weights(measured) * np.sinc(measured.hz * TS) ** 2
    p = s[:, None] / np.array([mode.omega for mode in modes])
    one = 1.0 / (p * p + 2.0 * np.array([mode.zeta for mode in modes]) * p + 1.0)
    columns = weight[:, None] * (np.hstack([one, p * one]) if speed else one)
    delays = np.asarray(late + DELAYS, dtype=np.float64)
    seen = (weight * measured.H)[:, None] * np.exp(np.outer(s, delays / TS))
    Q, R = np.linalg.qr(np.concatenate([columns.real, columns.imag]))
    explained = Q.T @ np.concatenate([seen.real, seen.imag])  # by each delay
    best = int(np.square(explained).sum(axis=0).argmax())
    found = np.linalg.solve(R, explained[:, best])
    c, d = found[: len(modes)], found[len(modes) :] if speed else 0.0
    return np.hypot(c, d) / abs(float(c.sum())), float(delays[best])
