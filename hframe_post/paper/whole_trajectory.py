"""Filtered B-splines over a whole trajectory (Sec. III): what the limited preview approximates.

==================  =======================================================  ==========
symbol              meaning                                                  source
==================  =======================================================  ==========
``E, n, m``         last sample; last control point; degree                  eq. 5
``g``               normalised knots                                         eq. 7
``N``               basis, (E + 1, n + 1)                                    eq. 5
``N_xx, N_yy``      the same through Gxx and Gyy, Ñ                          eq. 8
``N_xtheta``        the same through Gxθ                                     eq. 13
``D``               lever arm x_d − x_c of every sample                      eq. 14
``p_x, p_y``        control points                                           eq. 12
==================  =======================================================  ==========

A trajectory xy (E + 1, 2) begins at rest; splines and plant see its deviation from there.
"""

from __future__ import annotations

import numpy as np

from hframe_post.arrays import Array
from hframe_post.model.lpfbs import bsplines
from hframe_post.model.plant import Plant

DEGREE = 5  # of every figure of the paper


def knots(n: int, m: int) -> Array:
    """Return the normalised knot vector g, (m + n + 2,), clamped at both ends: eq. 7."""
    inner = np.arange(1, n - m + 1) / (n - m + 1)
    return np.concatenate([np.zeros(m + 1), inner, np.ones(m + 1)])


def basis(n: int, E: int, m: int = DEGREE) -> Array:
    """Return N (E + 1, n + 1) of eq. 5. Raises ValueError unless m ≤ n ≤ E."""
    if not m <= n <= E:
        raise ValueError(f"{n + 1} splines of degree {m} do not fit {E + 1} samples")
    return bsplines(knots(n, m), m, np.linspace(0.0, 1.0, E + 1))


class WholeTrajectory:
    """The filtered splines of one plant and trajectory, and the commands they give.

    xy (E + 1, 2), mm. Each command is (E + 1, 2) too. Raises ValueError as ``basis`` does.
    """

    def __init__(self, plant: Plant, xy: Array, n: int, m: int = DEGREE) -> None:
        E = len(xy) - 1
        self._origin = xy[0]
        self._x_d, self._y_d = (xy - xy[0]).T
        self._N = N = basis(n, E, m)
        Gxx, Gyy = (G.lifted(E + 1)[0] for G in (plant.Gxx, plant.Gyy))
        self._N_xx, self._N_yy = Gxx @ N, Gyy @ N
        self._N_xtheta = plant.Gxtheta.lifted(E + 1)[0] @ N if plant.Gxtheta else 0.0 * N
        self._D = xy[:, :1] - plant.x_c

    def decoupled(self, racking: bool = True) -> Array:
        """Return x of eq. 12 and y of eq. 19; without ``racking`` eq. 12 for both axes."""
        p_x = _least_squares(self._N_xx, self._x_d)
        delta_y = self._D[:, 0] * (self._N_xtheta @ p_x) if racking else 0.0  # eq. 14
        return self._command(p_x, _least_squares(self._N_yy, self._y_d - delta_y))

    def coupled(self) -> Array:
        """Return both axes, solved together: eq. 18."""
        N_r = np.block(
            [[self._N_xx, np.zeros_like(self._N_yy)], [self._D * self._N_xtheta, self._N_yy]]
        )
        p = _least_squares(N_r, np.concatenate([self._x_d, self._y_d]))
        return self._command(*np.split(p, 2))

    def _command(self, p_x: Array, p_y: Array) -> Array:
        return np.asarray(self._origin + self._N @ np.column_stack([p_x, p_y]))


def _least_squares(N: Array, target: Array) -> Array:
    """Return N† target by the singular values of N, O(l·v²) as in eq. 26 and 27."""
    return np.asarray(np.linalg.lstsq(N, target, rcond=None)[0])
