"""The responses of all axes, from recordings of each kind, and the modes they ring in, for people.

===============  ================================================================================
strokes          the start is known, so all delay is the printer's
others           all delay is the recording's, but for what damping explains
===============  ================================================================================

What damping explains follows from the modes that the regression found,

    H(f) = e^{−sτ}·sinc²(f·Ts)·Σ (c_i + d_i p_i) / (p_i² + 2ζ_i p_i + 1),   p_i = s/ω_i,  s = 2πjf

with τ the delay of the recording; c and d are what a mode contributes, by position and by speed.
sinc² stands for the command, played as straight lines between samples of Ts. All but τ is linear.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from hframe_post.arrays import TS, Array
from hframe_post.identification.estimation import known_start, unknown_start
from hframe_post.identification.estimation.frequency_response import (
    FrequencyResponse,
    advanced,
    lowest,
    share_left,
    weights,
)
from hframe_post.identification.estimation.regression import Fit, Mode

# share of the measurement that a response without an assumed mode may leave: of drawn linear
# printers 0.005 to 0.035, of real ones 0.06 to 0.3
LINEAR = 0.05
UNCALIBRATED = (1.0, 0.05)  # gain, as mean and standard deviation, after a rough one
EARLY = 4e-3  # s by which the rough start may be late
LISTED = 0.03  # of the motion at rest: modes that contribute less are not listed
RINGS = 0.3  # damping ratio below which a mode visibly rings
LATE = 2e-3  # s by which the delay of modes may differ from the response's lag
STEPS = 401  # of the delays that are tried: 10 µs
NEAR = 0.1  # of the response's resonance, within which the measured peak is


# ---------------------------------------------------------------------- a known start


def fit_known_start(whole: FrequencyResponse) -> Fit:
    """Return the response of recordings whose start is known: all delay is the printer's.

    Raises IdentificationError.
    """
    found = known_start.estimated(whole)
    return described(found, whole, found.lag)


def fit_racking(whole: FrequencyResponse, x: Fit, gain: float, in_time: bool) -> Fit:
    """Return what x does to the angle, which is 0 at rest.

    whole: rad/mm, as measured by a sensor of that gain in the recordings that ``x`` is of. in_time:
    whether they tell their start. Raises IdentificationError.
    """
    in_step = advanced(whole, x.delay)
    found = known_start.estimated_racking(in_step, gain, in_time)
    left = share_left(found.response(whole.hz), in_step, whole.power)
    return replace(found, residual=left, delay=x.delay)


# ---------------------------------------------------------------------- an unknown start


def fit_unknown_start(axes: Mapping[str, FrequencyResponse]) -> dict[str, Fit]:
    """Return the responses of recordings whose start and gain are unknown: all delay is theirs.

    Where a linear response explains a recording, the printer is late at low speed by what the
    damping of its modes explains, and the rest is the recording's start. Of other printers even
    that is unknown (``unknown_start``). If one axis is of these, all are: they are then assumed not
    to be late, and one of each would pull x and y apart. Raises IdentificationError.
    """
    ideal = {name: _with_an_ideal_mode(whole) for name, whole in axes.items()}
    if any(one.residual > LINEAR for one in ideal.values()):
        return ideal
    damped = {name: _from_its_damping(whole) for name, whole in axes.items()}
    linear = all(one.residual <= LINEAR for one in damped.values())
    return damped if linear else ideal


def _from_its_damping(whole: FrequencyResponse) -> Fit:
    """Return the response that is as late at low speed as the damping of its modes explains."""
    gain, late = unknown_start.gain_and_delay(whole)
    late -= EARLY
    scaled = replace(whole, H=whole.H / gain)
    in_time = advanced(scaled, late)
    rough = known_start.estimated(in_time, UNCALIBRATED)
    lag = rough.lag
    if modes := ringing(rough):
        seen = in_time.where(whole.hz >= rough.resonance_hz * unknown_start.MEASURED)
        late += shares(seen, modes, lag, speed=False)[1]
    else:  # too stiff to ring, so in time with it
        late += lag
    found = known_start.estimated(advanced(scaled, late), UNCALIBRATED)
    found = replace(found, gain=gain * found.gain, delay=late)
    return described(found, whole, late)


def _with_an_ideal_mode(whole: FrequencyResponse) -> Fit:
    """Return the response that follows its command below the resonance as one mode does."""
    found = unknown_start.estimated(whole)
    return described(found, whole, found.delay)


# ---------------------------------------------------------------------- both


def described(found: Fit, whole: FrequencyResponse, late: float) -> Fit:
    """Return the fit with the share that it leaves, and the modes that ring and count in the band.

    late: s, of the measurement, by recording and printer. Where the regression found no mode, it is
    the main resonance.
    """
    left = share_left(found.response(whole.hz), whole, whole.power)
    if modes := ringing(found):
        sizes, _ = shares(whole, modes, late, speed=True)
        counting = [mode for mode, size in zip(modes, sizes.tolist(), strict=True) if size > LISTED]
        known = sorted((mode.omega / (2.0 * np.pi * TS), mode.zeta) for mode in counting)
    else:
        known = [_resonance(found, whole)]
    listed = [(hz, zeta) for hz, zeta in known if zeta < RINGS and hz <= whole.hz[-1]]
    return replace(found, residual=left, modes=listed)


def ringing(found: Fit) -> list[Mode]:
    return [mode for mode in found.expected if mode.zeta < RINGS]


def _resonance(found: Fit, measured: FrequencyResponse) -> tuple[float, float]:
    """Return Hz and damping ratio of the measured peak at the resonance, whose height is 1/2ζ."""
    near = np.abs(measured.hz / found.resonance_hz - 1.0) < NEAR
    size = np.abs(measured.H / found.gain) * near
    peak = int(size.argmax())
    return float(measured.hz[peak]), float(0.5 / size[peak])


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
