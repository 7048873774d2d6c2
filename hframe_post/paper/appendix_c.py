"""Limited preview as Appendix C writes it, one window after another: coupled and decoupled.

The streamed commands of ``compensate`` are compared with these. Symbols as in ``lpfbs``; here, too,
the past is exact, and the effort penalty is the same.
"""

from __future__ import annotations

import numpy as np

from hframe_post.arrays import Array
from hframe_post.model.lpfbs import Window, window_splines
from hframe_post.model.plant import Plant
from hframe_post.model.transfer_function import TransferFunction


def windowed(plant: Plant, windows: tuple[Window, Window], xy: Array, coupled: bool) -> Array:
    """Return commands (n, 2) for a path xy (n, 2) that begins at rest; windows of equal sizes.

    coupled: x and y in one least-squares problem, eq. 42. Otherwise x first and y with the
    window's provisional p_x,C, eq. 43.
    """
    w, n = windows[0], len(xy)
    count = -(-n // w.stride)
    target = np.pad(xy, ((0, (count - 1) * w.stride + w.L_C - n), (0, 0)), mode="edge")
    solve = _coupled if coupled else _decoupled
    axes = _Axes(plant, windows)
    x, y, theta = axes.x, axes.y, axes.theta
    done = []
    for k in range(count):
        rows = slice(k * w.stride, k * w.stride + w.L_C)
        x_d, y_d = (target[rows] - xy[0]).T
        D = target[rows, 0] - plant.x_c
        p_x, p_y = solve(axes, x_d, y_d, D)
        theta.advance(x.p_P, p_x)  # sees the command of x
        done.append(np.column_stack([x.advance(x.p_P, p_x), y.advance(y.p_P, p_y)]))
        x.keep(p_x)
        y.keep(p_y)
    return np.asarray(xy[0] + np.concatenate(done)[:n])


class _Axes:
    """The filters of both axes and of racking."""

    def __init__(self, plant: Plant, windows: tuple[Window, Window]) -> None:
        self.x = _Filtered(plant.Gxx, windows[0])
        self.y = _Filtered(plant.Gyy, windows[1])
        none = np.zeros(0, dtype=complex)
        nothing = TransferFunction(none, none, 0.0)
        self.theta = _Filtered(plant.Gxtheta or nothing, windows[0])


def _decoupled(axes: _Axes, x_d: Array, y_d: Array, D: Array) -> tuple[Array, Array]:
    """Return p_x,C of eq. 39, then p_y,C of eq. 43."""
    x, y, theta = axes.x, axes.y, axes.theta
    p_x = x.pinv @ np.concatenate([x_d - x.free(x.p_P), -x.effort_P @ x.p_P])
    delta_y = D * (theta.free(x.p_P) + theta.N_C @ p_x)
    p_y = y.pinv @ np.concatenate([y_d - delta_y - y.free(y.p_P), -y.effort_P @ y.p_P])
    return p_x, p_y


def _coupled(axes: _Axes, x_d: Array, y_d: Array, D: Array) -> tuple[Array, Array]:
    """Return p_x,C and p_y,C of eq. 42; the matrix depends on D, so each window solves its own."""
    x, y, theta = axes.x, axes.y, axes.theta
    zero = np.zeros_like(x.N_C)
    N_r = np.block(
        [
            [x.N_C, zero],
            [D[:, None] * theta.N_C, y.N_C],
            [x.effort_C, zero],
            [zero, y.effort_C],
        ]
    )
    rest = np.concatenate(
        [
            x_d - x.free(x.p_P),
            y_d - D * theta.free(x.p_P) - y.free(y.p_P),
            -x.effort_P @ x.p_P,
            -y.effort_P @ y.p_P,
        ]
    )
    p_x, p_y = np.split(np.linalg.lstsq(N_r, rest, rcond=None)[0], 2)
    return p_x, p_y


class _Filtered:
    """A window's splines through one transfer function, and what the past left behind.

    N_C, N_P: filtered splines Ñ. effort_C, effort_P: √λ D N. z: state of the filter; p_P:
    the last m + 1 control points.
    """

    def __init__(self, G: TransferFunction, w: Window) -> None:
        N_P, N_C, D_P, D_C = window_splines(w)
        lifted, self._O, _, _ = G.lifted(w.L_C)
        self.N_P, self.N_C = lifted @ N_P, lifted @ N_C
        self.effort_P, self.effort_C = np.sqrt(w.effort) * D_P, np.sqrt(w.effort) * D_C
        self.pinv = np.linalg.pinv(np.vstack([self.N_C, self.effort_C]))
        _, _, self._A_T, self._R = G.lifted(w.stride)
        self._kept_P, self._kept_C = N_P[: w.stride], N_C[: w.stride, : w.n_up]
        self.z, self.p_P, self._n_up = np.zeros(G.order), np.zeros(w.degree + 1), w.n_up

    def free(self, p_P: Array) -> Array:
        """Return the motion that the past alone causes in the window, (L_C,).

        p_P: past control points of the axis that drives this one.
        """
        return self._O @ self.z + self.N_P @ p_P

    def advance(self, p_P: Array, p_C: Array) -> Array:
        """Advance the state over the kept control points; return their command (stride,)."""
        u = self._kept_P @ p_P + self._kept_C @ p_C[: self._n_up]
        self.z = self._A_T @ self.z + self._R @ u
        return np.asarray(u)

    def keep(self, p_C: Array) -> None:
        """Append the kept control points to the past."""
        self.p_P = np.concatenate([self.p_P, p_C[: self._n_up]])[-len(self.p_P) :]
