"""Discrete transfer functions: a way to write a response, and how it becomes one.

They are zeros, poles and gain, and computed as cascades of second-order sections with a real state
space A, B, C, D: the poles of a printer cluster near z = 1, where the expanded polynomial of eq. 4
loses all its digits.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from hframe_post.arrays import Array, Complex
from hframe_post.errors import ArgumentError
from hframe_post.native.linear import product, recursion

REAL_TOLERANCE = 1e-10  # imaginary part up to which a root counts as real
PAIR_TOLERANCE = 1e-9  # between a root and the conjugate of its partner


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
    def order(self) -> int:
        """Return the number of poles."""
        return len(self.poles)

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

    @cached_property
    def state_space(self) -> tuple[Array, Array, Array, float]:
        """Return real (A, B, C, D) of the cascade, shapes (d, d), (d,), (d,), scalar.

        The state has two numbers for each section.
        """
        A, B, C, D = np.zeros((0, 0)), np.zeros(0), np.zeros(0), 1.0
        for b0, b1, b2, _, a1, a2 in self.sections.tolist():
            a, b = np.array([[-a1, 1.0], [-a2, 0.0]]), np.array([b1 - a1 * b0, b2 - a2 * b0])
            A = np.block([[A, np.zeros((len(A), 2))], [np.outer(b, C), a]])
            B, C, D = np.concatenate([B, b * D]), np.concatenate([b0 * C, [1.0, 0.0]]), b0 * D
        return A, B, C, D

    def impulse(self, n: int) -> Array:
        """Return the first ``n`` samples of the impulse response."""
        A, B, C, D = self.state_space
        states = recursion(A.T, np.zeros((n - 1, len(A))), B).reshape(n, len(A))
        return np.concatenate([[D], product(states, C[:, None])[:, 0]])[:n]

    @cached_property
    def sections(self) -> Array:
        """Return the cascade as second-order sections (k, 6): b₀ b₁ b₂ 1 a₁ a₂ each."""
        cascade = np.zeros((max(-(-self.order // 2), 1), 6))
        cascade[0, [0, 3]] = 1.0  # of no poles, the gain alone
        for row, (num, den) in zip(cascade, _sections(self.zeros, self.poles), strict=False):
            row[:3] = np.pad(num, (len(den) - len(num), 3 - len(den)))
            row[3:] = np.pad(den, (0, 3 - len(den)))
        cascade[0, :3] *= self.gain
        return cascade


def upper_and_real(roots: Complex) -> tuple[Complex, Complex]:
    """Return which of conjugate roots are above the real axis, and which are on it."""
    return roots[roots.imag > REAL_TOLERANCE], roots[np.abs(roots.imag) <= REAL_TOLERANCE]


def _closed(roots: Complex) -> bool:
    """Return whether the roots that are not real form conjugate pairs."""
    upper, _ = upper_and_real(roots)
    lower, _ = upper_and_real(roots.conj())
    left = list(lower)
    for root in upper:
        nearest = min(left, key=_distance_to(root), default=np.inf)
        if abs(nearest - root) > PAIR_TOLERANCE:
            return False
        left.remove(nearest)
    return not left


def _distance_to(point: complex) -> Callable[[Complex], float]:
    return lambda roots: float(np.sqrt(_squared_modulus(roots - point)).min())


def _squared_modulus(z: Complex) -> Array:
    """Return |z|², in which processors agree to the last bit, unlike in |z|."""
    return np.asarray(np.square(z.real) + np.square(z.imag))


def _sections(zeros: Complex, poles: Complex) -> list[tuple[Array, Array]]:
    """Return second-order sections (num (≤3,), den (≤3,)): two poles each, and the nearest zeros.

    Poles nearest to the unit circle choose first, so that no section has a large gain. Complex
    zeros come in pairs and need a section of two poles; enough of these are reserved for them.
    """
    pairs, real = _pairs_and_real(zeros)
    single = list(real)
    groups, real = _pairs_and_real(poles)
    real = np.sort(real.real).astype(complex)
    groups += [real[k : k + 2] for k in range(0, len(real), 2)]  # a last one may be alone
    groups.sort(key=lambda group: -float(_squared_modulus(group).max()))
    sections = []
    for number, group in enumerate(groups, 1):
        distance, room = _distance_to(group[0]), len(group)
        pairs.sort(key=distance)
        single.sort(key=distance)
        later = sum(len(other) == 2 for other in groups[number:])
        near = pairs and not (single and distance(single[0]) <= distance(pairs[0]))
        if room == 2 and (near or len(pairs) > later):
            chosen = pairs.pop(0)
        else:
            chosen, single = np.array(single[:room], complex), single[room:]
        sections.append((_polynomial(chosen), _polynomial(group)))
    return sections


def _polynomial(roots: Complex) -> Array:
    """Return the monic polynomial with these roots: none, one, a conjugate pair or two real ones.

    ``np.poly`` sums with BLAS, whose rounding depends on the processor.
    """
    if len(roots) < 2:
        return np.array([1.0, *-roots.real])
    (a, b), (c, d) = roots.real.tolist(), roots.imag.tolist()
    return np.array([1.0, -(a + b), a * b - c * d])


def _pairs_and_real(roots: Complex) -> tuple[list[Complex], Complex]:
    upper, real = upper_and_real(roots)
    return [np.array([root, root.conjugate()]) for root in upper], real
