"""What modes a response rings in, for people, and how late their damping makes a printer.

    H(f) = e^{−sτ}·sinc²(f·Ts)·Σ (c_i + d_i p_i) / (p_i² + 2ζ_i p_i + 1),   p_i = s/ω_i,  s = 2πjf

=============  ==========================================================================
``ω_i, ζ_i``   natural frequency and damping ratio of a mode, as the regression found them
``c_i, d_i``   its contribution to the motion, by position and by speed
``τ``          delay of printer and recording together
=============  ==========================================================================

sinc² stands for the command, played as straight lines between samples of Ts. All but τ is linear.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hframe_post.arrays import TS, Array
from hframe_post.identification.estimation.frequency_response import (
    FrequencyResponse,
    lowest,
    weights,
)
from hframe_post.identification.estimation.regression import Fit, Mode

RINGS = 0.3  # damping ratio below which a mode visibly rings
LISTED = 0.03  # of the motion at rest: modes that contribute less are not listed
LATE = 2e-3  # s by which their delay may differ from the response's lag
STEPS = 401  # of the delays that are tried: 10 µs
NEAR = 0.1  # of the response's resonance, within which the measured peak is


def ringing(found: Fit) -> list[Mode]:
    return [mode for mode in found.expected if mode.zeta < RINGS]


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
    delays = np.linspace(late - LATE, late + LATE, STEPS)
    seen = (weight * measured.H)[:, None] * np.exp(np.outer(s, delays / TS))
    Q, R = np.linalg.qr(np.concatenate([columns.real, columns.imag]))
    explained = Q.T @ np.concatenate([seen.real, seen.imag])  # by each delay
    delay = lowest(delays, (-np.square(explained).sum(axis=0)).tolist())
    nearest = int(np.abs(delays - delay).argmin())
    found = np.linalg.solve(R, explained[:, nearest])
    c, d = found[: len(modes)], found[len(modes) :] if speed else 0.0
    return np.hypot(c, d) / abs(float(c.sum())), delay


def listed(found: Fit, measured: FrequencyResponse, late: float) -> list[tuple[float, float]]:
    """Return (Hz, damping ratio) of each mode that rings and counts, lowest first.

    late: s, of the measurement. Where the regression found none it is the main resonance.
    """
    modes = ringing(found)
    if modes:
        sizes, _ = shares(measured, modes, late, speed=True)
        counting = [mode for mode, size in zip(modes, sizes.tolist(), strict=True) if size > LISTED]
        known = sorted((mode.omega / (2.0 * np.pi * TS), mode.zeta) for mode in counting)
    else:
        known = [_resonance(found, measured)]
    return [(hz, zeta) for hz, zeta in known if zeta < RINGS and hz <= measured.hz[-1]]


def _resonance(found: Fit, measured: FrequencyResponse) -> tuple[float, float]:
    """Return Hz and damping ratio of the measured peak at the resonance, whose height is 1/2ζ."""
    near = np.abs(measured.hz / found.resonance_hz - 1.0) < NEAR
    size = np.abs(measured.H / found.gain) * near
    peak = int(size.argmax())
    return float(measured.hz[peak]), float(0.5 / size[peak])
