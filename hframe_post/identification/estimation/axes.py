"""The responses of all axes, from recordings of each kind.

===============  ================================================================================
strokes          the start is known, so all delay is the printer's
others           all delay is the recording's, but for what damping explains
===============  ================================================================================
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from hframe_post.identification.estimation import known_start, unknown_start
from hframe_post.identification.estimation.frequency_response import (
    FrequencyResponse,
    advanced,
    share_left,
)
from hframe_post.identification.estimation.modes import listed, ringing, shares
from hframe_post.identification.estimation.regression import Fit

# share of the measurement that a response without an assumed mode may leave: of drawn linear
# printers 0.005 to 0.035, of real ones 0.06 to 0.3
LINEAR = 0.05
UNCALIBRATED = (1.0, 0.05)  # gain, as mean and standard deviation, after a rough one
EARLY = 4e-3  # s by which the rough start may be late


# ---------------------------------------------------------------------- a known start


def fit_known_start(whole: FrequencyResponse) -> Fit:
    """Return the response of recordings whose start is known: all delay is the printer's.

    Raises IdentificationError.
    """
    found = known_start.estimated(whole)
    return _described(found, whole, found.lag)


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
    return _described(found, whole, late)


def _with_an_ideal_mode(whole: FrequencyResponse) -> Fit:
    """Return the response that follows its command below the resonance as one mode does."""
    found = unknown_start.estimated(whole)
    return _described(found, whole, found.delay)


# ---------------------------------------------------------------------- both


def _described(found: Fit, whole: FrequencyResponse, late: float) -> Fit:
    """Return the fit of a response; late: s, of the measurement, by recording and printer."""
    left = share_left(found.response(whole.hz), whole, whole.power)
    return replace(found, residual=left, modes=listed(found, whole, late))
