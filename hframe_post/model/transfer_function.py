"""Discrete transfer functions: roots, state space and lifted form.

=================  ====================================================  ===========
symbol             meaning                                               source
=================  ====================================================  ===========
``A, B, C, D``     state space of one transfer function                  eq. 4
``G``              lifted (matrix) form: Toeplitz of impulse response    Appendix A
``O``              free response of a block to the state before it       Appendix A
``R``              state after a block, reached by the block's input     Appendix A
=================  ====================================================  ===========

Transfer functions live as zeros, poles and gain and become cascades of second-order
sections: the poles of a printer cluster near z = 1, where the expanded polynomial of
eq. 4 loses all its digits.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hframe_post.arrays import Array, Complex
from hframe_post.model.recursion import Recursion

REAL_TOLERANCE = 1e-12  # imaginary part below which a root counts as real
BLOCK_SAMPLES = 64  # lifted blocks: matrix products on one side, the scan on the other


@dataclass(frozen=True)
class TransferFunction:
    """A stable, proper, real discrete transfer function gain·Π(z − zeros)/Π(z − poles).

    zeros (q,), poles (d,) complex, closed under conjugation, q ≤ d, |poles| < 1.
    Raises ValueError where this does not hold.
    """

    zeros: Complex
    poles: Complex
    gain: float

    def __post_init__(self) -> None:
        for name in ("zeros", "poles"):
            roots = np.atleast_1d(np.asarray(getattr(self, name), dtype=complex))
            object.__setattr__(self, name, roots)
            if not np.isfinite(roots).all():
                raise ValueError(f"{name} must be finite")
            if not np.allclose(np.sort_complex(roots), np.sort_complex(roots.conj()), atol=1e-9):
                raise ValueError(f"complex {name} must come in conjugate pairs")
        if not np.isfinite(self.gain):
            raise ValueError("gain must be finite")
        if len(self.zeros) > len(self.poles):
            raise ValueError("more zeros than poles: the transfer function would need the future")
        radius = np.abs(self.poles).max(initial=0.0)
        if radius >= 1.0:
            raise ValueError(f"unstable: largest pole modulus {radius:.6g}")

    @property
    def order(self) -> int:
        """Number of poles, and of states."""
        return len(self.poles)

    @property
    def dc_gain(self) -> float:
        """Gain at rest, G(z = 1)."""
        return float(self.response(np.zeros(1))[0].real)

    def response(self, omega: Array) -> Complex:
        """Complex frequency response at ``omega`` (rad/sample), same shape."""
        z = np.exp(1j * omega)[..., None]
        numerator, denominator = (np.prod(z - roots, axis=-1) for roots in (self.zeros, self.poles))
        return np.asarray(self.gain * numerator / denominator)

    @cached_property
    def state_space(self) -> tuple[Array, Array, Array, float]:
        """Real (A, B, C, D), shapes (d, d), (d,), (d,), scalar: a cascade of sections."""
        A, B, C, D = np.zeros((0, 0)), np.zeros(0), np.zeros(0), self.gain
        for num, den in _sections(self.zeros, self.poles):
            a, b, c, d = _section_state_space(num, den)
            A = np.block([[A, np.zeros((len(A), len(a)))], [np.outer(b, C), a]])
            B, C, D = np.concatenate([B, b * D]), np.concatenate([d * C, c]), d * D
        return A, B, C, D

    def impulse(self, n: int) -> Array:
        """First ``n`` samples of the impulse response."""
        A, B, C, D = self.state_space
        h = np.empty(n)
        state = B
        if n:
            h[0] = D
        for k in range(1, n):
            h[k] = C @ state
            state = A @ state
        return h

    def lifted(self, n: int) -> tuple[Array, Array, Array, Array]:
        """Lifted form over blocks of ``n`` samples: (G, O, An, R).

        With the state s before a block and its input u (n,): output y = G u + O s and
        next state An s + R u. Shapes (n, n), (n, d), (d, d), (d, n). Appendix A, with the
        past carried as a state in place of the rows above the block.
        """
        A, B, C, _ = self.state_space
        d = self.order
        O, R = np.empty((n, d)), np.empty((d, n))
        row, column = C.copy(), B.copy()
        for k in range(n):
            O[k], R[:, n - 1 - k] = row, column
            row, column = row @ A, A @ column
        delay = np.subtract.outer(np.arange(n), np.arange(n))
        G = np.where(delay >= 0, self.impulse(n)[np.maximum(delay, 0)], 0.0)
        return G, O, np.linalg.matrix_power(A, n), R

    @cached_property
    def block(self) -> tuple[Array, Array, Recursion, Array]:
        """Lifted form over BLOCK_SAMPLES: (G, O, recursion of the state, R)."""
        G, O, An, R = self.lifted(BLOCK_SAMPLES)
        return G, O, Recursion(An), R


def _sections(zeros: Complex, poles: Complex) -> list[tuple[Array, Array]]:
    """Second-order sections (num (≤3,), den (≤3,)): each pole pair with its nearest zeros.

    Pairs nearest to the unit circle choose first, so that no section has a large gain. Complex
    zeros need a section of two poles for themselves: one that is left to them takes no real zero.
    """
    pole_groups = sorted(_real_groups(poles), key=lambda g: -np.abs(g).max())
    left = list(zeros)
    sections = []
    for number, group in enumerate(pole_groups):
        chosen: list[complex] = []
        later = sum(len(other) == 2 for other in pole_groups[number + 1 :])
        while left and len(chosen) < len(group):
            paired = [r for r in left if abs(r.imag) > REAL_TOLERANCE]
            needed = len(group) == 2 and not chosen and len(paired) > 2 * later
            nearest = min(paired if needed else left, key=lambda r: abs(r - group[0]))
            if abs(nearest.imag) > REAL_TOLERANCE:
                if len(group) - len(chosen) < 2:
                    reals = [r for r in left if abs(r.imag) <= REAL_TOLERANCE]
                    if not reals:
                        break
                    nearest = min(reals, key=lambda r: abs(r - group[0]))
                else:
                    conjugate = min(left, key=lambda r: abs(r - nearest.conjugate()))
                    left.remove(conjugate)
                    left.remove(nearest)
                    chosen += [nearest, conjugate]
                    continue
            left.remove(nearest)
            chosen.append(nearest)
        num = np.poly(np.array(chosen)).real if chosen else np.ones(1)
        sections.append(
            (np.asarray(num, dtype=float), np.asarray(np.poly(group).real, dtype=float))
        )
    if left:
        raise ValueError("zeros and poles do not pair into real second-order sections")
    return sections


def _real_groups(roots: Complex) -> list[Complex]:
    """Roots in groups of two that make real polynomials (a last real one may be alone)."""
    upper = roots[roots.imag > REAL_TOLERANCE]
    real = np.sort(roots[np.abs(roots.imag) <= REAL_TOLERANCE].real)
    groups = [np.array([r, r.conjugate()]) for r in upper]
    return groups + [real[k : k + 2].astype(complex) for k in range(0, len(real), 2)]


def _section_state_space(num: Array, den: Array) -> tuple[Array, Array, Array, float]:
    """Controllable canonical form of one section, both in descending powers, den monic."""
    order = len(den) - 1
    b = np.concatenate([np.zeros(order + 1 - len(num)), num])
    A = np.eye(order, k=-1)
    A[0] = -den[1:]
    B = np.zeros(order)
    B[0] = 1.0
    return A, B, b[1:] - b[0] * den[1:], float(b[0])
