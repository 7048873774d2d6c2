"""From continuous time to samples, exact for a command played as straight lines between samples.

Each term C(sI − F)⁻¹g, F and g per sample, becomes A, B, C, D of a first-order hold:

    x[k+1] = A x[k] + first·u[k] + second·(u[k+1] − u[k])

with u[k+1] taken out of the state. A delay is whole samples and an all-pass for the rest.
"""

from __future__ import annotations

import numpy as np
from scipy import linalg

from hframe_post.arrays import Array, Complex
from hframe_post.model.transfer_function import TransferFunction

Term = tuple[Array, Array, Array]  # F (d, d), g (d,), C (d,)
REAL = 1e-12  # imaginary part below which a root is real
WHOLE = 1e-4  # coefficient of an all-pass below which its delay is a whole sample


def discretize(terms: list[Term], zeros_at_rest: int) -> TransferFunction:
    """Return the sum of ``terms`` for a command of straight lines.

    Exactly ``zeros_at_rest`` zeros are placed at z = 1.
    """
    steps = [_first_order_hold(*term) for term in terms]
    A: Array = linalg.block_diag(*(A for A, _, _ in steps))
    B = np.concatenate([B for _, B, _ in steps])
    C = np.concatenate([C for _, _, C in terms])
    D = sum(D for _, _, D in steps)
    poles = np.concatenate([_conjugate_pairs(linalg.eigvals(A)) for A, _, _ in steps])
    zeros = _zeros(A, B, C, D)
    if zeros_at_rest:
        near = np.argsort(np.abs(zeros - 1.0))[:zeros_at_rest]
        moved: Complex = np.append(np.delete(zeros, near), np.ones(zeros_at_rest))
        zeros = _conjugate_pairs(moved)
        # the gain at rest is zero, so match the gain from 3 to 100 Hz
        z = np.exp(1j * 2.0 * np.pi * np.geomspace(0.003, 0.1, 50))
    else:
        z = np.ones(1, complex)
    wanted = np.array([C @ linalg.solve(point * np.eye(len(A)) - A, B) + D for point in z])
    unscaled = TransferFunction(zeros, poles, 1.0).response(np.angle(z))
    gain = np.vdot(unscaled, wanted).real / np.vdot(unscaled, unscaled).real
    return TransferFunction(zeros, poles, float(gain))


def delayed(G: TransferFunction, samples: float) -> TransferFunction:
    """Return G behind a delay, which is right to 0.01 samples up to 100 Hz.

    The delay is made of whole samples and a first-order Thiran all-pass of 0.5 to 1.5 samples.
    """
    if samples < 0.01:
        return G
    whole = int(max(np.floor(samples - 0.5), 0.0))
    rest = samples - whole
    a = float((1.0 - rest) / (1.0 + rest))
    poles = np.append(G.poles, np.zeros(whole))
    if abs(a) < WHOLE:  # its zero, -1/a, would be of any size
        return TransferFunction(G.zeros, np.append(poles, 0.0), G.gain)
    return TransferFunction(np.append(G.zeros, -1.0 / a), np.append(poles, -a), G.gain * a)


def _first_order_hold(F: Array, g: Array, C: Array) -> tuple[Array, Array, float]:
    n = len(F)
    whole = np.zeros((n + 2, n + 2))  # states, command, its change over the sample
    whole[:n, :n], whole[:n, n], whole[n, n + 1] = F, g, 1.0
    step = linalg.expm(whole)
    A, first, second = step[:n, :n], step[:n, n], step[:n, n + 1]
    return A, A @ second + first - second, float(C @ second)


def _zeros(A: Array, B: Array, C: Array, D: float) -> Complex:
    n = len(A)
    system = np.block([[A, B[:, None]], [C[None], np.array([[D]])]])
    left, right = linalg.eigvals(system, np.diag([1.0] * n + [0.0]), homogeneous_eigvals=True)
    finite = np.abs(left) < 1e4 * np.abs(right)
    return _conjugate_pairs(left[finite] / right[finite])


def _conjugate_pairs(roots: Complex) -> Complex:
    """Return roots of a real polynomial, exactly closed under conjugation."""
    roots = np.asarray(roots, complex)
    upper = roots[roots.imag > REAL]
    real = roots[np.abs(roots.imag) <= REAL].real.astype(complex)
    return np.concatenate([upper, upper.conj(), real])
