"""Discrete transfer functions: a way to write a response, and how it becomes one.

They are zeros, poles and gain, and computed factor by factor: the poles of a printer cluster near
z = 1, where the expanded polynomial of eq. 4 loses all its digits.
"""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass, replace

import numpy as np

from hframe_post.arrays import Array, Complex
from hframe_post.errors import ArgumentError
from hframe_post.native.linear import product, recursion


@dataclass(frozen=True)
class TransferFunction:
    """A stable, proper, real discrete transfer function gain·Π(z − zeros)/Π(z − poles).

    zeros (q,), poles (d,) complex, closed under conjugation, q ≤ d, |poles| < 1.
    Raises ArgumentError otherwise.
    """

    zeros: Complex
    poles: Complex
    gain: float

    def __post_init__(self) -> None:
        for name in ("zeros", "poles"):
            roots = np.atleast_1d(np.asarray(getattr(self, name), dtype=complex))
            object.__setattr__(self, name, roots)
            if not np.isfinite(roots).all():
                raise ArgumentError(f"{name} must be finite")
            if not _closed(roots):
                raise ArgumentError(f"complex {name} must come in conjugate pairs")
        if not np.isfinite(self.gain):
            raise ArgumentError("gain must be finite")
        if len(self.zeros) > len(self.poles):
            raise ArgumentError("more zeros than poles: that would need the future")
        radius = np.abs(self.poles).max(initial=0.0)
        if radius >= 1.0:
            raise ArgumentError(f"unstable: largest pole modulus {radius:.6g}")

    @property
    def dc_gain(self) -> float:
        """Return the gain at rest, G(z = 1)."""
        return float(self.response(np.zeros(1))[0].real)

    @property
    def lag(self) -> float:
        """Return how much the output falls behind at a constant speed of 1 per sample, samples.

        With a gain of 0 at rest it is how far the speed moves the output, backwards.
        """
        to_zeros, to_poles = 1.0 - self.zeros, 1.0 - self.poles
        without_one = sum(
            (np.prod(np.delete(to_zeros, k)) for k in range(len(to_zeros))), start=0.0 + 0.0j
        )
        slope = without_one - np.prod(to_zeros) * (1.0 / to_poles).sum()
        return float((-self.gain * slope / np.prod(to_poles)).real) + 0.0

    def response(self, omega: Array) -> Complex:
        """Return the complex frequency response at ``omega`` (rad/sample), same shape."""
        z = np.exp(1j * omega)[..., None]
        numerator, denominator = (np.prod(z - roots, axis=-1) for roots in (self.zeros, self.poles))
        with np.errstate(all="ignore"):  # at a pole it is infinite
            return np.asarray(self.gain * numerator / denominator)

    def heavier(self, factor: float) -> TransferFunction:
        """Return it with ``factor`` times the mass behind its modes.

        Of s²/ω² + 2ζs/ω + 1, for each pair of poles or zeros, only the first term grows: ω and ζ
        fall by √factor, and the gain at rest and the lag stay. So do real roots, and pairs above
        a quarter of the sampling rate: lags and delays.
        """

        def moved(root: complex) -> complex:
            if root.imag == 0.0 or root.real <= 0.0:
                return root
            s = cmath.log(root)
            decay = s.real / factor
            ringing = math.sqrt(abs(s) ** 2 / factor - decay * decay)
            return cmath.exp(complex(decay, math.copysign(ringing, s.imag)))

        zeros, poles = (np.array([*map(moved, each.tolist())]) for each in (self.zeros, self.poles))
        new = TransferFunction(zeros, poles, self.gain)
        return replace(new, gain=self.gain * self.dc_gain / new.dc_gain)

    def impulse(self, n: int) -> Array:
        """Return the first ``n`` samples of the impulse response.

        The factors (z − zero)/(z − pole) follow each other, those of the slowest poles first, each
        with the zero that is nearest. Real and imaginary parts, (n, 2), are multiplied as matrices.
        """
        h, zeros = np.zeros((n, 2)), self.zeros.tolist()
        h[0, 0] = self.gain
        for pole in sorted(self.poles.tolist(), key=_squared_modulus, reverse=True):
            before = np.vstack([np.zeros((1, 2)), h[:-1]])
            if zeros:
                before = h - product(before, _turn(_taken(zeros, pole)))
            h = recursion(_turn(pole), before, np.zeros(2))[2:].reshape(n, 2)
        return h[:, 0].copy()


def _closed(roots: Complex) -> bool:
    """Return whether the roots that are not real form conjugate pairs."""
    upper, lower = (roots[sign * roots.imag > 1e-10] for sign in (1.0, -1.0))  # others are real
    if len(upper) != len(lower):
        return False
    left = lower.conj().tolist()
    return all(abs(_taken(left, root) - root) <= 1e-9 for root in upper.tolist())


def _taken(roots: list[complex], place: complex) -> complex:
    """Return the root nearest to a place, and take it out of the list."""
    distances = [_squared_modulus(root - place) for root in roots]
    return roots.pop(distances.index(min(distances)))


def _squared_modulus(z: complex) -> float:
    """Return |z|², in which processors agree to the last bit, unlike in |z|."""
    return z.real * z.real + z.imag * z.imag


def _turn(root: complex) -> Array:
    """Return the matrix (2, 2) by which a row of real and imaginary part is multiplied."""
    return np.array([[root.real, root.imag], [-root.imag, root.real]])
