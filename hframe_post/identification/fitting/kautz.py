"""Real rational functions of z in an orthogonal basis, and their least-squares coefficients.

======================  ===================================================================
``D_k``                 z² + a₁z + a₂, section k of the denominator, or z + a₁ (a last one)
``D̃_k``                 its reverse, 1 + a₁z + a₂z²: D̃_k / D_k is an all-pass, 1 at z = 1
``B_2k, B_2k+1``        Π_{j<k} D̃_j/D_j · (z − 1)/D_k and (z + 1)/D_k, orthogonal on |z| = 1
======================  ===================================================================

G = Σ c_i B_i has relative degree one or more, with a constant added (``direct``) zero or more.
Source: two-parameter Kautz functions (Wahlberg 1994); relocation of poles in such a basis:
Deschrijver, Haegeman and Dhaene 2007. Powers of z would lose all digits: poles of a printer
cluster near z = 1.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import linalg

from hframe_post.arrays import Array, Complex
from hframe_post.model.transfer_function import TransferFunction, upper_and_real

FAR = 1e4  # modulus above which a zero is one at infinity: it changes nothing below Nyquist


@dataclass(frozen=True)
class Denominator:
    """Sections ``pairs`` (s, 2) of a₁, a₂ and, for an odd order, the pole ``single``."""

    pairs: Array
    single: float | None = None

    @property
    def order(self) -> int:
        """Number of poles."""
        return 2 * len(self.pairs) + (self.single is not None)

    @property
    def poles(self) -> Complex:
        """All poles, (order,), in the sections' order."""
        roots = [self.section_poles(a1, a2) for a1, a2 in self.pairs]
        single = [] if self.single is None else [np.array([self.single], complex)]
        return np.concatenate([*roots, *single, np.zeros(0, complex)])

    @staticmethod
    def section_poles(a1: float, a2: float) -> Complex:
        """Both roots of z² + a₁z + a₂ without cancellation."""
        square = a1 * a1 / 4.0 - a2
        if square < 0.0:
            root = complex(-a1 / 2.0, np.sqrt(-square))
            return np.array([root, root.conjugate()])
        large = -a1 / 2.0 - np.copysign(np.sqrt(square), a1)
        return np.array([large, a2 / large if large else 0.0], complex)

    def basis(self, z: Complex, direct: bool = False) -> Complex:
        """B at ``z`` (k,): (k, order), with ``direct`` and a last column of ones."""
        out = np.ones((len(z), self.order + direct), complex)
        through = np.ones(len(z), complex)
        for k, (a1, a2) in enumerate(self.pairs):
            shared = through / ((z + a1) * z + a2)
            out[:, 2 * k], out[:, 2 * k + 1] = (z - 1.0) * shared, (z + 1.0) * shared
            through = shared * ((a2 * z + a1) * z + 1.0)
        if self.single is not None:
            out[:, self.order - 1] = through / (z - self.single)
        return out

    def states(self) -> tuple[Array, Array, Array]:
        """A (d, d), B (d,) and T (d, d) with the basis functions T·(zI − A)⁻¹B."""
        d = self.order
        A, B, T = np.zeros((d, d)), np.zeros(d), np.zeros((d, d))
        through, direct = np.zeros(d), 1.0  # output of the all-passes so far
        for k, (a1, a2) in enumerate(self.pairs):
            i = 2 * k
            A[i], B[i] = through, direct
            A[i, i : i + 2] = -a1, -a2
            A[i + 1, i] = 1.0
            T[i, i : i + 2], T[i + 1, i : i + 2] = (1.0, -1.0), (1.0, 1.0)
            through, direct = a2 * through, a2 * direct
            through[i : i + 2] += a1 * (1.0 - a2), 1.0 - a2 * a2
        if self.single is not None:
            A[-1], B[-1] = through, direct
            A[-1, -1] = self.single
            T[-1, -1] = 1.0
        return A, B, T


def denominator(poles: Complex, radius: float) -> Denominator:
    """Sections of ``poles`` (closed under conjugation), reflected and kept inside ``radius``."""
    modulus = np.abs(poles)
    outside = modulus > 1.0
    poles = np.where(outside, poles / np.maximum(modulus, 1.0) ** 2, poles)
    poles = poles * np.minimum(1.0, 0.9999 * radius / np.maximum(np.abs(poles), 1e-12))
    upper, real = upper_and_real(poles)
    real = np.sort(real.real)
    single = float(real[0]) if len(real) % 2 else None
    real = real[len(real) % 2 :].reshape(-1, 2)
    pairs = [(-2.0 * p.real, abs(p) ** 2) for p in upper]
    pairs += [(-(p + q), p * q) for p, q in real]
    return Denominator(np.array(pairs, float).reshape(-1, 2), single)


def transfer_function(den: Denominator, c: Array, at_rest: float, z: Complex) -> TransferFunction:
    """Σ c_i B_i as zeros, poles and gain, with ``at_rest`` (0 or 1) at z = 1 exact.

    c (order,), or (order + 1,) where a constant is among them.

    ``z`` (k,): points where the gain is matched if it cannot be at rest.
    """
    A, B, T = den.states()
    d = den.order
    direct = len(c) > d
    system = np.block([[A, B[:, None]], [(c[:d] @ T)[None], np.full((1, 1), c[-1] * direct)]])
    left, right = linalg.eigvals(system, np.diag([1.0] * d + [0.0]), homogeneous_eigvals=True)
    finite = np.abs(left) < FAR * np.abs(right)
    zeros = _conjugate(left[finite] / right[finite])
    if at_rest == 0.0:
        real = np.flatnonzero(zeros.imag == 0.0)
        zeros[real[np.argmin(np.abs(zeros[real] - 1.0))]] = 1.0
    poles = den.poles
    if at_rest != 0.0:
        return TransferFunction(
            zeros, poles, float((at_rest * np.prod(1.0 - poles) / np.prod(1.0 - zeros)).real)
        )
    unscaled = TransferFunction(zeros, poles, 1.0).response(np.angle(z))
    wanted = den.basis(z, direct) @ c
    gain = np.vdot(unscaled, wanted).real / np.vdot(unscaled, unscaled).real
    return TransferFunction(zeros, poles, float(gain))


def _conjugate(roots: Complex) -> Complex:
    """Roots of a real polynomial, exactly closed under conjugation."""
    upper, real = upper_and_real(roots)
    return np.concatenate([upper, upper.conj(), real.real])
