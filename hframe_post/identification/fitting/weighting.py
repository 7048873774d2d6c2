"""Assumptions shared by all fits: measurement noise, sensor gain, and where modes may lie."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hframe_post.arrays import Array, Complex
from hframe_post.errors import IdentificationError
from hframe_post.identification.responses.frequency_response import FrequencyResponse

NOISE_FLOOR = 0.003  # relative noise of H that is assumed at the least
# gain of a sensor, as mean and standard deviation: of any sensor, and of an exact one
SENSOR = (1.0, 0.03)
EXACT = (1.0, 1e-4)


@dataclass(frozen=True, slots=True)
class Distortion:
    """The share (k,) of a measured response that is nonlinear, at hz (k,) ascending.

    certain: how much of it is known in phase and size, 0 to 1.
    """

    hz: Array
    share: Complex
    certain: float

    def at(self, hz: Array) -> Complex:
        """Return the share interpolated at ``hz``."""
        real, imaginary = (np.interp(hz, self.hz, k) for k in (self.share.real, self.share.imag))
        return np.asarray(real + 1j * imaginary)

    def removed_from(self, response: FrequencyResponse) -> FrequencyResponse:
        """Return the linear part of a response, as far as it is known."""
        return replace(response, H=response.H * (1.0 - self.certain * self.at(response.hz)))

    def remaining(self, hz: Array) -> Array:
        """Return the relative error (k,) that ``removed_from`` may leave, at least 30 %."""
        return np.asarray(max(1.0 - self.certain, 0.3) * np.abs(self.at(hz)))


def mode_range(band_hz: tuple[float, float]) -> tuple[float, float]:
    """Return the frequencies (Hz) between which modes may lie, for a measured band."""
    return 0.5 * band_hz[0], band_hz[1]


def weights(part: FrequencyResponse, noise_floor: float | Array = NOISE_FLOOR) -> Array:
    """Return one over the standard deviation of H, (k,).

    The standard deviation is at least ``noise_floor`` of |H| and 0.2 % of the largest |H|.
    Frequencies that the sweep hardly excites get 0. Raises IdentificationError without a signal.
    """
    if not (np.isfinite(part.H).all() and np.isfinite(part.coherence).all()):
        raise IdentificationError("the frequency response has values that are not finite")
    largest = float(np.abs(part.H).max(initial=0.0))
    if largest == 0.0 or not (part.power * part.coherence).any():
        raise IdentificationError("the frequency response or its coherence is zero in the band")
    sd = np.hypot(np.hypot(part.noise, noise_floor) * np.abs(part.H), 0.002 * largest)
    return np.asarray((part.power > 1e-3 * np.median(part.power)) / sd)
