"""The responses of all axes, from recordings of each kind.

===============  ================================================================================
strokes          the start is known, so all delay is the printer's
others           all delay is the recording's, but for what damping explains
===============  ================================================================================
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from hframe_post.arrays import TS, Array, Complex
from hframe_post.identification.estimation import known_start, unknown_start
from hframe_post.identification.estimation.frequency_response import (
    FrequencyResponse,
    advanced,
    share_left,
)
from hframe_post.identification.estimation.modes import Modes, described
from hframe_post.identification.estimation.regression import Estimated, Mode
from hframe_post.model.impulse_response import ImpulseResponse

RINGS = 0.3  # damping ratio below which a mode visibly rings
# share of the measurement that a response without an assumed mode may leave: of drawn linear
# printers 0.005 to 0.035, of real ones 0.06 to 0.3
LINEAR = 0.05
UNCALIBRATED = (1.0, 0.05)  # gain, as mean and standard deviation, after a rough one
EARLY = 4e-3  # s by which the rough start may be late
LISTED = 0.03  # of the motion at rest: modes that contribute less are not listed
DESCRIBED_LATE = 2e-3  # s by which their delay may differ from the response's lag
NEAR = 1e-5  # s; likewise where the delay is known


@dataclass(frozen=True, slots=True)
class Measured:
    """A transfer function as measured.

    places: the response at each position (mm of x). mean: their average. spread: RMS difference of
    the positions from the mean, relative; repeated: likewise of runs in one direction.
    excited_hz: lowest and highest frequency that is excited. resonance_hz: the lowest strong
    resonance, if the recordings are not calibrated. known_start: whether they are of strokes.
    """

    places: list[tuple[float, FrequencyResponse]]
    mean: FrequencyResponse
    spread: float
    repeated: float
    excited_hz: tuple[float, float] = (0.0, np.inf)
    resonance_hz: float | None = None
    known_start: bool = False

    @property
    def runs(self) -> list[FrequencyResponse]:
        return [response for _, response in self.places]

    def excited(self, band_hz: tuple[float, float]) -> list[FrequencyResponse]:
        """Return the runs where they were excited within the band."""
        low, high = self.excited_hz
        band = max(band_hz[0], low), min(band_hz[1], high)
        return [run.within(band) for run in self.runs]


@dataclass(frozen=True, slots=True)
class Fit:
    """The response ``G`` and how it was found.

    residual: share of the measurement that it leaves, weighted with input power. gain: of the
    sensor, not part of G. recording_delay: s, not part of G.
    measured: what was estimated. sum: of modes, that describes the measurement; of racking, none.
    highest_hz: up to which it was measured.
    """

    G: ImpulseResponse
    residual: float
    gain: float
    recording_delay: float
    measured: Estimated
    sum: Modes | None = None
    highest_hz: float = np.inf

    @property
    def lag(self) -> float:
        """Return how late the printer is at a constant speed, s."""
        return self.G.lag * TS

    @property
    def modes(self) -> list[tuple[float, float]]:
        """Return (Hz, damping ratio) of each mode that rings and counts, lowest first."""
        if self.sum is None:
            return []
        hz, zeta = self.sum.hz, self.sum.zeta
        listed = (self.sum.sizes > LISTED) & (zeta < RINGS) & (hz <= self.highest_hz)
        return sorted(zip(hz[listed].tolist(), zeta[listed].tolist(), strict=True))

    def response(self, hz: Array) -> Complex:
        """Return the model of the measurement at ``hz`` (k,), including gain and all delay."""
        return self.measured.response(hz)


# ---------------------------------------------------------------------- a known start


def fit_known_start(whole: FrequencyResponse) -> Fit:
    """Return the response of recordings whose start is known: all delay is the printer's.

    Raises IdentificationError.
    """
    found = known_start.estimated(whole)
    late = found.G.lag * TS
    delays = (late - DESCRIBED_LATE, late + DESCRIBED_LATE)
    return _described(found, whole, delays)


def begun(found: Fit, late: float) -> Fit:
    """Return the fit of recordings that began ``late``, s, found from what they were without it."""
    assert found.sum is not None
    return replace(
        found, recording_delay=late, measured=replace(found.measured, delay=late),
        sum=replace(found.sum, delay=found.sum.delay + late),
    )  # fmt: skip


def fit_racking(whole: FrequencyResponse, x: Fit, gain: float, in_time: bool) -> Fit:
    """Return what x does to the angle, which is 0 at rest.

    whole: rad/mm, as measured by a sensor of that gain in the recordings that ``x`` is of. in_time:
    whether they tell their start. Raises IdentificationError.
    """
    recording_delay = x.recording_delay
    found = known_start.estimated_coupling(advanced(whole, recording_delay), gain, in_time)
    left = share_left(found.response(whole.hz), whole, whole.power)
    found = replace(found, delay=recording_delay)
    return Fit(found.G, left, gain, recording_delay, found, None, float(whole.hz[-1]))


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
    if any(mode.zeta < RINGS for mode in rough.modes):
        seen = whole.hz >= rough.resonance_hz * unknown_start.MEASURED
        lag = rough.G.lag * TS
        bounds = (lag - DESCRIBED_LATE, lag + DESCRIBED_LATE)
        late += _in_modes(rough, in_time.where(seen), bounds, UNCALIBRATED, speed=False).delay
    else:  # too stiff to ring, so in time with it
        late += rough.G.lag * TS
    found = known_start.estimated(advanced(scaled, late), UNCALIBRATED)
    found = replace(found, gain=gain * found.gain, delay=late)
    return _described(found, whole, (late - NEAR, late + NEAR))


def _with_an_ideal_mode(whole: FrequencyResponse) -> Fit:
    """Return the response that follows its command below the resonance as one mode does."""
    found = unknown_start.estimated(whole)
    return _described(found, whole, (found.delay - NEAR, found.delay + NEAR))


# ---------------------------------------------------------------------- both


def _described(found: Estimated, whole: FrequencyResponse, delays: tuple[float, float]) -> Fit:
    """Return the fit of a response whose modes are late as these bounds tell, s."""
    gain = (found.gain, 0.03 * abs(found.gain))
    modes = _in_modes(found, whole, delays, gain, speed=True)
    left = share_left(found.response(whole.hz), whole, whole.power)
    return Fit(found.G, left, found.gain, found.delay, found, modes, float(whole.hz[-1]))


def _in_modes(
    found: Estimated, whole: FrequencyResponse, delays: tuple[float, float],
    gain: tuple[float, float], speed: bool,
) -> Modes:  # fmt: skip
    ringing = [mode for mode in found.modes if mode.zeta < RINGS]
    start = ringing or [Mode(2.0 * np.pi * TS * found.resonance_hz, 0.1)]
    return described(whole, start, delays, gain, speed)
