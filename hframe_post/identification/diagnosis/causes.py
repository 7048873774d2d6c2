"""What makes harmonics, acted out: what each cause would do to a sweep of the linear printer.

===========  ================================================  ===============
cause        force, or motion                                  heard through
===========  ================================================  ===============
friction     −sign(v), on the carriage                         1 − G
backlash     the motor's way, less the play b, less that way   s²·G
hardening    e³, of a belt that is pulled by e = u − x         1 − G
one-sided    e²                                                1 − G
===========  ================================================  ===============

u is the command, x and v = dx/dt are the linear printer's answer to it, G is that printer without
its delay, behind which all is heard. The sweep sways: it turns around less often than a sine
does, and friction and play are the smaller for it. Of friction and of belts the size is a factor;
play is acted out anew for each.

Friction and play go along alike with frequency. They differ in phase, as the carriage turns around
later than the motor, and in how they grow where the motion becomes as small as the play.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft, rfftfreq

from hframe_post.arrays import TS, Array, Complex

ORDER = {"friction": 3, "backlash": 3, "hardening": 3, "one-sided": 2}  # of the harmonic
TAIL = 2000  # samples in which an answer dies away
HIGH_HZ = (240.0, 300.0)  # above which nothing is heard, and from where on less


@dataclass(frozen=True, slots=True)
class Linear:
    """A printer's linear part. response: of hz (k,), as measured: with gain and delay (s)."""

    response: Callable[[Array], Complex]
    gain: float
    delay: float


class Stage:
    """A sweep on which causes act. command (m,): mm every 1 ms, along the swept axis."""

    def __init__(self, command: Array, printer: Linear) -> None:
        self._m = len(command)
        self._n = next_fast_len(self._m + TAIL, real=True)
        hz = rfftfreq(self._n, TS)
        self._s: Complex = 2j * np.pi * hz
        low, high = HIGH_HZ
        self._heard = np.clip((high - hz) / (high - low), 0.0, 1.0)
        late = np.exp(-self._s * printer.delay)
        self._G = printer.response(hz) / (late * printer.gain * np.sinc(hz * TS) ** 2)
        self._behind = self._heard * late * printer.gain
        self._u = np.zeros(self._n)
        self._u[: self._m] = command - command[0]
        self._sent = rfft(self._u)

    def acted(self, cause: str, size: float) -> Array:
        """Acceleration (m,), mm/s², that the sensor hears of it.

        size: mm of play; of other causes a factor.
        """
        if cause == "backlash":
            way = played(self._u, size) - self._u
            return self._through(way, self._s**2 * self._G)
        return size * self._through(self._force(cause), 1.0 - self._G)

    def _force(self, cause: str) -> Array:
        if cause == "friction":
            v = irfft(self._s * self._G * self._heard * self._sent, self._n)
            # a sample in which v passes through 0 counts by its share of either sign
            return np.asarray(-np.clip(v / (0.5 * np.abs(np.gradient(v)) + 1e-9), -1.0, 1.0))
        e = irfft((1.0 - self._G) * self._sent, self._n)
        return np.asarray(e**3 if cause == "hardening" else e**2)

    def _through(self, signal: Array, path: Complex) -> Array:
        return np.asarray(irfft(rfft(signal) * path * self._behind, self._n)[: self._m])


def played(u: Array, play: float) -> Array:
    """Where a carriage is (n,) that u (n,) takes along with so much play, mm.

    y_k = min(max(y_{k−1}, u_k − b/2), u_k + b/2). Such steps in a row make one of the same form,
    so all are put together by doubling.
    """
    low, high = u - play / 2.0, u + play / 2.0
    low[0] = high[0] = u[0]
    span = 1
    while span < len(u):
        floor, ceiling = low[span:].copy(), high[span:].copy()
        low[span:] = np.clip(low[:-span].copy(), floor, ceiling)
        high[span:] = np.clip(high[:-span].copy(), floor, ceiling)
        span *= 2
    return low
