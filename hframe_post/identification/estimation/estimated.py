"""An estimated impulse response."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hframe_post.arrays import TS, Array, Complex
from hframe_post.identification.estimation.kernel import Mode
from hframe_post.identification.estimation.regression import Prior
from hframe_post.model.impulse_response import ImpulseResponse


@dataclass(frozen=True, slots=True)
class Estimated:
    """The response G, without the sensor's gain and the delay (s) of the recording.

    resonance_hz: where |G| is greatest. prior: what was expected of it, if a regression found that.
    """

    G: ImpulseResponse
    gain: float
    delay: float
    resonance_hz: float
    prior: Prior | None = None

    @property
    def modes(self) -> tuple[Mode, ...]:
        """Return the modes that it was expected to ring in, those that explain most first."""
        return self.prior.modes if self.prior else ()

    def response(self, hz: Array) -> Complex:
        """Return what the sensor shows at ``hz`` (k,), including gain and delay."""
        turned = np.exp(-2j * np.pi * hz * self.delay)
        return np.asarray(self.gain * turned * self.G.response(2.0 * np.pi * TS * hz))
