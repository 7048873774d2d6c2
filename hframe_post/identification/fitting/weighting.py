"""What every fit of a frequency response takes for granted: noise, sensors, where modes lie."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hframe_post.arrays import Array, Complex
from hframe_post.errors import IdentificationError
from hframe_post.identification.responses.frequency_response import FrequencyResponse

FLOOR = 0.003  # relative noise of H below which no measurement is believed
SMALL = 0.002  # the same, of the largest |H|
QUIET = 1e-3  # input power, of the median, below which a frequency counts nothing
SENSOR = (1.0, 0.03)  # gain of a sensor: what is expected, and one standard deviation
EXACT = (1.0, 1e-4)  # of one that reads what is
LEFT = 0.3  # of what is not linear, which its cause does not tell at the least
INSIDE = 0.5  # of the band's low end, below which no pole lies


@dataclass(frozen=True, slots=True)
class Distortion:
    """Of a measured response, by what is not linear: share (k,) of it at hz (k,), ascending.

    sure: how much of that is known in phase and size, 0 … 1.
    """

    hz: Array
    share: Complex
    sure: float

    def at(self, hz: Array) -> Complex:
        """Its share at other frequencies."""
        real, imaginary = (np.interp(hz, self.hz, k) for k in (self.share.real, self.share.imag))
        return np.asarray(real + 1j * imaginary)

    def without(self, response: FrequencyResponse) -> FrequencyResponse:
        """The linear part of a response, as far as it is known."""
        return replace(response, H=response.H * (1.0 - self.sure * self.at(response.hz)))

    def left(self, hz: Array) -> Array:
        """What ``without`` may leave of it, relative."""
        return np.asarray(max(1.0 - self.sure, LEFT) * np.abs(self.at(hz)))


def modes_within(band_hz: tuple[float, float]) -> tuple[float, float]:
    """Where modes may lie, Hz, of a measurement of that band."""
    return INSIDE * band_hz[0], band_hz[1]


def weights(part: FrequencyResponse, floor: float | Array = FLOOR) -> Array:
    """One over the standard deviation of H, (k,), which is never below ``floor`` of it.

    Raises IdentificationError without a signal.
    """
    if not (np.isfinite(part.H).all() and np.isfinite(part.coherence).all()):
        raise IdentificationError("the frequency response has values that are not finite")
    largest = float(np.abs(part.H).max(initial=0.0))
    if largest == 0.0 or not (part.power * part.coherence).any():
        raise IdentificationError("the frequency response or its coherence is zero in the band")
    sd = np.hypot(np.hypot(part.noise, floor) * np.abs(part.H), SMALL * largest)
    return np.asarray((part.power > QUIET * np.median(part.power)) / sd)
