"""Commands as the paper computes them: over a whole trajectory, and with limited preview.

Over a whole trajectory (Sec. III, what the preview approximates):

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

With limited preview (Appendix C), one window after another: the streamed commands of ``compensate``
are compared with these. Symbols as in ``lpfbs``; here, too, the past is exact, and the effort
penalty is the same.
"""

from __future__ import annotations

import numpy as np

from hframe_post.arrays import Array
from hframe_post.model.impulse_response import FiniteFilter, ImpulseResponse
from hframe_post.model.lpfbs import Window, bsplines, window_splines
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


def lifted(G: ImpulseResponse, n: int) -> Array:
    """Return the lifted form of a causal response over n samples, (n, n): Appendix A."""
    reversed_h = np.concatenate([G.impulse(n)[::-1], np.zeros(n - 1)])
    return np.lib.stride_tricks.sliding_window_view(reversed_h, n)[::-1]


class WholeTrajectory:
    """The filtered splines of one plant and trajectory, and the commands they give.

    xy (E + 1, 2), mm. Each command is (E + 1, 2) too. Raises ValueError as ``basis`` does.
    """

    def __init__(self, plant: Plant, xy: Array, n: int) -> None:
        E = len(xy) - 1
        self._origin = xy[0]
        self._x_d, self._y_d = (xy - xy[0]).T
        self._N = N = basis(n, E)
        Gxx, Gyy = lifted(plant.Gxx, E + 1), lifted(plant.Gyy, E + 1)
        self._N_xx, self._N_yy = Gxx @ N, Gyy @ N
        self._N_xtheta = 0.0 * N
        if plant.Gxtheta is not None:
            self._N_xtheta = lifted(plant.Gxtheta, E + 1) @ N
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
    def __init__(self, plant: Plant, windows: tuple[Window, Window]) -> None:
        self.x = _Filtered(plant.Gxx, windows[0])
        self.y = _Filtered(plant.Gyy, windows[1])
        nothing = ImpulseResponse(np.zeros(1), 0, rest=0.0)
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
        [[x.N_C, zero], [D[:, None] * theta.N_C, y.N_C], [x.effort_C, zero], [zero, y.effort_C]]
    )
    y_rest = y_d - D * theta.free(x.p_P) - y.free(y.p_P)
    efforts = -x.effort_P @ x.p_P, -y.effort_P @ y.p_P
    p_x, p_y = np.split(
        _least_squares(N_r, np.concatenate([x_d - x.free(x.p_P), y_rest, *efforts])), 2
    )
    return p_x, p_y


class _Filtered:
    """A window's splines through one response, and what the past left behind.

    N_C, N_P: filtered splines Ñ. effort_C, effort_P: √λ D N. past: filter whose state is the
    command so far; p_P: the last m + 1 control points.
    """

    def __init__(self, G: ImpulseResponse, w: Window) -> None:
        N_P, N_C, D_P, D_C = window_splines(w)
        by_window = lifted(G, w.L_C)
        self.N_P, self.N_C = by_window @ N_P, by_window @ N_C
        self.effort_P, self.effort_C = np.sqrt(w.effort) * D_P, np.sqrt(w.effort) * D_C
        self.pinv = np.linalg.pinv(np.vstack([self.N_C, self.effort_C]))
        self._past, self._nothing = FiniteFilter(G, 0), np.zeros(w.L_C)
        self._kept_P, self._kept_C = N_P[: w.stride], N_C[: w.stride, : w.n_up]
        self.p_P, self._n_up = np.zeros(w.degree + 1), w.n_up

    def free(self, p_P: Array) -> Array:
        """Return the motion that the past alone causes in the window, (L_C,).

        p_P: past control points of the axis that drives this one.
        """
        known = np.append(self._past.state, self._nothing)
        return self._past.output(known, len(self._nothing)) + self.N_P @ p_P

    def advance(self, p_P: Array, p_C: Array) -> Array:
        """Advance the state over the kept control points; return their command (stride,)."""
        u = self._kept_P @ p_P + self._kept_C @ p_C[: self._n_up]
        self._past.run(u)
        return np.asarray(u)

    def keep(self, p_C: Array) -> None:
        self.p_P = np.concatenate([self.p_P, p_C[: self._n_up]])[-len(self.p_P) :]
