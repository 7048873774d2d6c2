"""Modes without lag at constant speed, as transfer functions and as impulse responses."""

import numpy as np

from hframe_post.arrays import TS, Array, Complex
from hframe_post.model.transfer_function import TransferFunction


def deviation_of_mode(hz: float, damping: float, m: int) -> Array:
    """Return what a mode adds to an axis after a pulse of acceleration, m samples in µm."""
    w = 2.0 * np.pi * hz * TS
    ringing, j = w * np.sqrt(1.0 - damping**2), np.arange(m)
    return np.asarray(-np.exp(-damping * w * j) * np.sin(ringing * j) / ringing)


def axis_mode(hz: float, damping: float) -> TransferFunction:
    """Return the transfer function 1 + (z − 2 + 1/z)·Q(z) of that mode."""
    denominator, size = _resonance(hz, damping)
    numerator = denominator - size * np.array([1.0, -2.0, 1.0])
    return TransferFunction(_roots(numerator), _roots(denominator), float(numerator[0]))


def damped_by_the_frame(hz: float, damping: float) -> TransferFunction:
    """Return that mode with its damper between axis and frame: it lags, and by a delay of 2 ms."""
    poles = _roots(_resonance(hz, damping)[0])
    return TransferFunction(np.zeros(0, complex), poles, float(np.prod(1.0 - poles).real))


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
