"""Printers whose modes move x and y together, as measured."""

from dataclasses import dataclass

import numpy as np

from hframe_post.arrays import Array, Complex
from hframe_post.identification.estimation.frequency_response import FrequencyResponse

BAND = (4.0, 100.0)
HZ = np.arange(BAND[0], BAND[1], 0.125)
AVERAGES = 12.0
X_C = 120.0  # mm
Pair = tuple[FrequencyResponse, FrequencyResponse]


@dataclass(frozen=True)
class Coupled:
    """A printer of two modes at right angles, turned by ``angle`` (rad) against x and y.

    own: share of a mode at 75 Hz that only a command in x excites, and only in y. racking: rad
    per mm/s² about x_c. turned: of the sensor, rad.
    """

    hz: tuple[float, float] = (45.0, 32.0)
    zeta: tuple[float, float] = (0.06, 0.08)
    angle: float = 0.2
    own: float = 0.0
    racking: float = 0.0
    turned: float = 0.0
    delay: float = 1.5e-3

    def response(self, hz: Array, x: float = X_C) -> Complex:
        """Return the matrix (k, 2, 2) of the nozzle at x (mm)."""
        s = np.asarray(2j * np.pi * hz)
        c, d = np.cos(self.angle), np.sin(self.angle)
        shapes = np.array([[c, d], [-d, c]])
        modes = [_mode(s, *each) for each in zip(self.hz, self.zeta, strict=True)]
        G = np.einsum("mk,mi,mj->kij", np.array(modes), shapes, shapes)
        own = self.own * np.subtract(_mode(s, 75.0, 0.08), _mode(s, 45.0, 0.06))
        theta = self.racking * s**2 * _mode(s, 60.0, 0.1) * _mode(s, self.hz[0], self.zeta[0])
        G[:, 1, 0] += own + (x - X_C) * theta
        return np.asarray(G * np.exp(-s * self.delay)[:, None, None])

    def measured(
        self, direction: tuple[float, float], seed: int, x: float = X_C, noise: float = 0.003
    ) -> Pair:
        """Return the responses of the sensor's x and y to a run along the direction.

        noise: of a response, as a share of the command.
        """
        d = np.divide(direction, np.hypot(*direction))
        H = (self._sensed(HZ, x) @ d).T
        rng = np.random.default_rng(seed)
        H = H + noise * (rng.standard_normal(H.shape) + 1j * rng.standard_normal(H.shape)) / 2**0.5
        coherence = np.abs(H) ** 2 / (np.abs(H) ** 2 + AVERAGES * noise**2)
        first, second = (
            FrequencyResponse(HZ, *each, np.ones(len(HZ)), AVERAGES)
            for each in zip(H, coherence, strict=True)
        )
        return first, second

    def _sensed(self, hz: Array, x: float) -> Complex:
        c, s = np.cos(self.turned), np.sin(self.turned)
        return np.asarray(np.array([[c, s], [-s, c]]) @ self.response(hz, x))


def _mode(s: Complex, hz: float, zeta: float) -> Complex:
    w = 2.0 * np.pi * hz
    return np.asarray(w * w / (s * s + 2.0 * zeta * w * s + w * w))
