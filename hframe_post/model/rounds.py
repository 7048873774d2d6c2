"""In which order the axes of a coupled plant are solved, and whether that converges.

The commands u = (x_dm, y_dm) shall meet D u = r_d − C u, with D = (Gxx, Gyy) and the couplings C.
The axes are solved in turn, each for the latest command of the other, from u = r_d on. A round then
multiplies the error of u at each frequency by a matrix; see docs/derivations.md.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hframe_post.arrays import Array, X, Y
from hframe_post.model.lpfbs import Window
from hframe_post.model.plant import Coupling, Plant

LEFT = 0.03  # share of the first error that rounds may leave
FEWEST, MOST = 2, 4  # rounds


def order(couplings: Sequence[Coupling], rounds: int) -> tuple[int, ...]:
    """Return the axes to solve in turn.

    An axis that couplings act on comes after the one whose command they act by. Only where x and y
    act on each other or on themselves, more rounds are needed.
    """
    acting = {(coupling.command, coupling.answer) for coupling in couplings}
    if acting <= {(X, Y)}:
        return X, Y
    if acting == {(Y, X)}:
        return Y, X
    return (X, Y) * rounds


def rounds_needed(plant: Plant, windows: tuple[Window, Window]) -> int:
    """Return how many rounds leave little of the error, where lever arms are short."""
    centres = ([c.centre for c in plant.couplings if c.along == axis] for axis in (X, Y))
    middle = np.array([np.mean(each) if each else 0.0 for each in centres])
    factor = contraction(plant, windows, middle)
    return next((n for n in range(FEWEST, MOST) if factor**n <= LEFT), MOST)


def contraction(plant: Plant, windows: tuple[Window, Window], place: Array) -> float:
    """Return the greatest factor by which a round multiplies an error of the commands, at a place.

    It is the spectral radius at the worst frequency that the splines can follow. There a solver
    multiplies by S = G*/(|G|² + λ|1 − z⁻¹|⁴), which is 1/G where that takes little effort; the
    doubts of G, squared, add to the denominator.
    """
    if len(order(plant.couplings, FEWEST)) == 2:  # one round is exact
        return 0.0
    omega = np.pi / windows[X].L * np.linspace(0.01, 1.0, 300)
    effort = np.abs(1.0 - np.exp(-1j * omega)) ** 4
    S_x, S_y = (
        G.response(omega).conj()
        / (sum(np.abs(each.response(omega)) ** 2 for each in (G, *G.doubts)) + w.effort * effort)
        for G, w in zip((plant.Gxx, plant.Gyy), windows, strict=True)
    )
    C = np.zeros((2, 2, len(omega)), complex)
    for coupling in plant.couplings:
        lever = np.ravel(coupling.lever(place[None]))[0]
        C[coupling.answer, coupling.command] += lever * coupling.G.response(omega)
    to_x, to_y = -S_x * C[X], -S_y * C[Y]
    to_y = np.array([to_y[X] * to_x[X], to_y[X] * to_x[Y] + to_y[Y]])  # by the new x
    return float(np.abs(np.linalg.eigvals(np.array([to_x, to_y]).transpose(2, 0, 1))).max())
