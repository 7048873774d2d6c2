"""Transfer functions of printers and of single modes, their impulse responses, and a sweep."""

import numpy as np
from scipy.signal import sosfilt, zpk2sos

from examples.paper.tables import transfer_functions
from hframe_post.arrays import TS, Array, Complex
from hframe_post.model.impulse_response import FiniteFilter, ImpulseResponse
from hframe_post.model.transfer_function import TransferFunction


def resonant(hz: float, damping: float, *real: float, moving: bool = False) -> TransferFunction:
    """Return a resonance and real poles at ``real`` Hz; 1 at rest, or 0 with ``moving``.

    It lags, as a mode whose damper is between axis and frame, and by a delay of 1 ms a pole.
    """
    s = 2.0 * np.pi * hz * (-damping + 1j * np.sqrt(1.0 - damping**2))
    poles = np.exp(1e-3 * np.array([s, s.conjugate(), *(-2.0 * np.pi * np.array(real))]))
    zeros = np.ones(int(moving), complex)
    gain = abs(np.prod(1.0 - poles)) * (0.02 if moving else 1.0)
    return TransferFunction(zeros, poles, float(gain))


def drawn(seed: int) -> list[TransferFunction]:
    """Return Gxx, Gyy, Gxθ of a random printer: resonances 20–90 Hz, damping 0.03–0.3."""
    rng = np.random.default_rng(seed)
    hz, damping = rng.uniform(20.0, 90.0, 3), rng.uniform(0.03, 0.3, 3)
    real = rng.uniform(30.0, 150.0, 3)
    return [
        resonant(hz[0], damping[0], real[0]),
        resonant(hz[1], damping[1], *real[1:]),
        resonant(hz[2], damping[2], moving=True),
    ]


def all_of_them() -> list[TransferFunction]:
    """Return the paper's three and those of three random printers."""
    paper = [*transfer_functions().values()]
    return paper + [G for seed in (1, 2, 3) for G in drawn(seed)]


class Filter:
    """A response applied to a stream, its state carried; of a transfer function, by scipy."""

    def __init__(self, G: TransferFunction | ImpulseResponse) -> None:
        self._own = FiniteFilter(G, 0) if isinstance(G, ImpulseResponse) else None
        if isinstance(G, TransferFunction):
            self._sections = zpk2sos(G.zeros, G.poles, G.gain)
            self._delayed = np.zeros(len(G.poles) - len(G.zeros))  # zeros at infinity
            self._state = np.zeros((len(self._sections), 2))

    def run(self, u: Array) -> Array:
        if self._own is not None:
            return self._own.run(u)
        u = np.concatenate([self._delayed, u])
        u, self._delayed = np.split(u, [len(u) - len(self._delayed)])
        y, self._state = sosfilt(self._sections, u, zi=self._state)
        return np.asarray(y)


def at(G: TransferFunction, hz: Array, delay: float = 0.0) -> Complex:
    return np.asarray(G.response(2e-3 * np.pi * hz) * np.exp(-2j * np.pi * hz * delay))


def sweep(rate: float = 1.0) -> Array:
    """Return 3000 mm/s² from 2 to 120 Hz at ``rate`` Hz/s, and 2 s of rest on both sides."""
    seconds = 118.0 / rate
    t = np.arange(0.0, seconds, 1e-3)
    taper = np.clip(np.minimum(t, seconds - t) / 0.5, 0.0, 1.0)
    return np.pad(3000.0 * taper * np.sin(2.0 * np.pi * (2.0 * t + rate * t * t / 2.0)), 2000)


def deviation_of_mode(hz: float, damping: float, m: int) -> Array:
    """Return what a mode adds to an axis after a pulse of acceleration, m samples in µm."""
    w = 2.0 * np.pi * hz * TS
    ringing, j = w * np.sqrt(1.0 - damping**2), np.arange(m)
    return np.asarray(-np.exp(-damping * w * j) * np.sin(ringing * j) / ringing)


def axis_mode(hz: float, damping: float) -> TransferFunction:
    """Return a mode without lag at constant speed, 1 + (z − 2 + 1/z)·Q(z)."""
    denominator, size = _resonance(hz, damping)
    numerator = denominator - size * np.array([1.0, -2.0, 1.0])
    return TransferFunction(_roots(numerator), _roots(denominator), float(numerator[0]))


def coupling_mode(hz: float, damping: float, gain: float) -> TransferFunction:
    """Return gain times what that mode adds to an axis."""
    denominator, size = _resonance(hz, damping)
    return TransferFunction(np.ones(2, complex), _roots(denominator), -gain * size)


def _roots(polynomial: Array) -> Complex:
    return np.roots(polynomial).astype(complex)


def _resonance(hz: float, damping: float) -> tuple[Array, float]:
    w = 2.0 * np.pi * hz * TS
    ringing = w * np.sqrt(1.0 - damping**2)
    radius = np.exp(-damping * w)
    denominator = np.array([1.0, -2.0 * radius * np.cos(ringing), radius**2])
    return denominator, float(radius * np.sin(ringing) / ringing)
