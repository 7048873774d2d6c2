"""From continuous time to samples: exact where a command is played as straight lines between them.

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
FAR = 1e4  # modulus above which a zero is one at infinity
REAL = 1e-12  # imaginary part below which a root is real
LEAST = 0.01  # samples of delay that are one
MATCHED = np.exp(1j * 2.0 * np.pi * np.geomspace(0.003, 0.1, 50))  # where gains are matched


def held(terms: list[Term], zeros_at_rest: int) -> TransferFunction:
    """The sum of terms under a command of straight lines, with so many zeros at z = 1."""
    steps = [_step(*term) for term in terms]
    A: Array = linalg.block_diag(*(one[0] for one in steps))
    B = np.concatenate([one[1] for one in steps])
    C = np.concatenate([term[2] for term in terms])
    D = sum(one[2] for one in steps)
    poles = np.concatenate([_conjugate(linalg.eigvals(one[0])) for one in steps])
    zeros = _zeros(A, B, C, D)
    if zeros_at_rest:
        near = np.argsort(np.abs(zeros - 1.0))[:zeros_at_rest]
        zeros = _conjugate(np.append(np.delete(zeros, near), np.ones(zeros_at_rest)))
    z = MATCHED if zeros_at_rest else np.ones(1, complex)
    wanted = np.array([C @ linalg.solve(one * np.eye(len(A)) - A, B) + D for one in z])
    plain = TransferFunction(zeros, poles, 1.0).response(np.angle(z))
    return TransferFunction(
        zeros, poles, float(np.vdot(plain, wanted).real / np.vdot(plain, plain).real)
    )


def delayed(G: TransferFunction, samples: float) -> TransferFunction:
    """G behind a delay: whole samples and an all-pass of 0.5 to 1.5 (Thiran, of first order),
    whose delay is right to 0.01 samples up to 100 Hz."""
    if samples < LEAST:
        return G
    whole = int(max(np.floor(samples - 0.5), 0.0))
    rest = samples - whole
    a = float((1.0 - rest) / (1.0 + rest))
    late = np.append(G.poles, np.zeros(whole))
    if abs(a) < REAL:
        return TransferFunction(G.zeros, np.append(late, 0.0), G.gain)
    return TransferFunction(np.append(G.zeros, -1.0 / a), np.append(late, -a), G.gain * a)


def _step(F: Array, g: Array, C: Array) -> tuple[Array, Array, float]:
    """A, B and D of one term."""
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
    finite = np.abs(left) < FAR * np.abs(right)
    return _conjugate(left[finite] / right[finite])


def _conjugate(roots: Complex) -> Complex:
    """Roots of a real polynomial, exactly closed under conjugation."""
    roots = np.asarray(roots, complex)
    upper = roots[roots.imag > REAL]
    real = roots[np.abs(roots.imag) <= REAL].real.astype(complex)
    return np.concatenate([upper, upper.conj(), real])
