"""Limited-preview filtered B-splines (Appendix B) with an exact past.

==============  ===========================================================  ==========
symbol          meaning                                                      source
==============  ===========================================================  ==========
``m, L``        degree; samples between knots                                eq. 37
``n_C, n_up``   coefficients solved in a window, and those kept of them      App. B
``L_C``         samples in a window, n_C·L                                   App. B
``N_C, N_P``    splines that begin in the window, and before it              eq. 38
``N_filtered``  the same through the plant, Ñ, and its doubts                eq. 8
``p_C, p_P``    control points of the window, and the m + 1 before it        eq. 39
``effort``      λ, weight on the command's second difference                 —
``s``           the past, as the next window needs it: p_P of all the reach  —
``lead``        samples by which the plant responds before the command       —
==============  ===========================================================  ==========

The paper truncates the impulse response where it reaches back (the bar over N). Here the past is
all control points that the response reaches, which is exact, so one step of the recursion is a
constant linear map of (s, window of x_d). If the response
begins before the command, the solver sees the plant and its target ``lead`` samples late: the
command comes at its right time, and the preview is shorter by the lead. Where the response says
how well it is known, the command has the least expected squared error: its doubts are more filters
whose output shall be zero. This takes more rows of the same matrix, and the maps stay as large.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hframe_post.arrays import Array
from hframe_post.errors import ArgumentError
from hframe_post.model.impulse_response import FiniteFilter, ImpulseResponse
from hframe_post.native.linear import product, pseudo_inverse, recursion, windows_product


@dataclass(frozen=True, slots=True)
class Window:
    """Sizes and effort of the limited preview; see the symbol table above."""

    L: int
    n_C: int
    n_up: int
    effort: float
    degree: int = 5

    def __post_init__(self) -> None:
        if self.L < 2 or self.degree < 2 or not 1 <= self.n_up <= self.n_C:
            raise ArgumentError("a window needs L ≥ 2, degree ≥ 2 and 1 ≤ n_up ≤ n_C")
        if not self.effort >= 0.0:
            raise ArgumentError("effort must not be negative")

    @property
    def L_C(self) -> int:
        """Return the number of samples in a window."""
        return self.n_C * self.L

    @property
    def stride(self) -> int:
        """Return the number of samples from one window to the next."""
        return self.n_up * self.L


def bsplines(knots: Array, degree: int, t: Array) -> Array:
    """Return the basis functions N_{j,m}(t), (len(t), len(knots) − m − 1), by eq. 6.

    Intervals are half open; the last one that is not empty is closed, so that the basis
    sums to one up to and including the last knot.
    """
    lower, upper = knots[:-1], knots[1:]
    N = ((t[:, None] >= lower) & (t[:, None] < upper)).astype(float)
    N[t == knots[-1], np.flatnonzero(upper > lower)[-1]] = 1.0
    for d in range(1, degree + 1):
        rise, fall = knots[d:-1] - knots[: -d - 1], knots[d + 1 :] - knots[1:-d]
        with np.errstate(divide="ignore", invalid="ignore"):
            up = np.where(rise > 0, (t[:, None] - knots[: -d - 1]) / rise, 0.0)
            down = np.where(fall > 0, (knots[d + 1 :] - t[:, None]) / fall, 0.0)
        N = up * N[:, :-1] + down * N[:, 1:]
    return N


def uniform_basis(L: int, degree: int) -> Array:
    """Return the m + 1 splines that overlap one knot interval at its L samples, (L, m + 1)."""
    knots = np.arange(-degree, degree + 2, dtype=float)
    return bsplines(knots, degree, np.arange(L) / L)[:, : degree + 1]


def window_splines(w: Window) -> tuple[Array, Array, Array, Array]:
    """Return a window's splines and their second differences: N_P, N_C, D N_P, D N_C.

    Shapes (L_C, m + 1) for the past ones, (L_C, n_C) for the current ones: eq. 38.
    """
    past = w.degree + 1
    knots = w.L * np.arange(-past, w.n_C + w.degree + 1, dtype=float)
    samples = np.arange(-2, w.L_C, dtype=float)
    N = bsplines(knots, w.degree, samples)  # rows −2 and −1 only serve D
    D = np.diff(N, n=2, axis=0)
    return N[2:, :past], N[2:, past:], D[:, :past], D[:, past:]


class Lpfbs:
    """Solver of one axis: from the target x_d to the command x_dm, with the past s passed along.

    Raises ArgumentError where the window cannot be solved or the recursion would diverge:
    ``radius``, the spectral radius of one step's map of the past, must be below one.
    """

    def __init__(self, G: ImpulseResponse, window: Window) -> None:
        self.window, self.lead = window, G.ahead
        self._basis = np.asfortranarray(uniform_basis(window.L, window.degree))
        K_target, K_past, step_past = _solve(G, window)
        # its transpose is multiplied, window by window, and needs no copy then
        self._K_past = np.asfortranarray(K_past)
        self._by_target = np.ascontiguousarray(K_target.T)
        self.rest = np.zeros(len(step_past))  # the past of an axis that stood at zero
        self._step_past = step_past
        if not (_shrinks(step_past) or self.radius < 1.0):
            raise ArgumentError(
                f"the recursion diverges: spectral radius {self.radius:.3g} with L = {window.L}, "
                f"n_C = {window.n_C}, n_up = {window.n_up}, effort = {window.effort:g}; "
                "take a longer preview (larger n_C), wider knots (larger L) or more effort"
            )

    @property
    def radius(self) -> float:
        """Return the spectral radius of one step's map of the past."""
        return float(np.abs(np.linalg.eigvals(self._step_past)).max())

    def command(self, x_d: Array) -> Array:
        """Return the command (n,) for a whole target x_d (n,), from rest at x_d[0].

        The target is at rest after its end. The command has no samples before the start to lead,
        or after the end to settle: pad x_d with rest to get them. Raises ArgumentError for
        another shape.
        """
        if np.ndim(x_d) != 1:
            raise ArgumentError(f"x_d must be (n,), it is {np.shape(x_d)}")
        pieces = Pieces(self)
        return np.asarray(x_d[:1] + np.concatenate([pieces.feed(x_d - x_d[:1]), pieces.finish()]))

    def run(self, x_d: Array, s: Array) -> tuple[Array, Array]:
        """Return the command x_dm (W·stride,) for W whole windows of x_d, and the next s.

        x_d is ``lead`` samples late. It has (W − 1)·stride + L_C samples, of which the last
        L_C − stride are the preview and come again with the next call. Both are relative to where
        the axis stood when the stream began. Raises ArgumentError for any other length.
        """
        w = self.window
        if len(x_d) < w.L_C or (len(x_d) - w.L_C) % w.stride:
            raise ArgumentError(
                f"{len(x_d)} samples are not a whole number of windows ({w.L_C} plus any multiple "
                f"of {w.stride}); command() takes any length"
            )
        by_target = windows_product(x_d, w.stride, self._by_target)
        control = recursion(self._K_past.T, by_target, s)  # s and then p of each window, eq. 39
        command = windows_product(control[len(s) - w.degree :], 1, self._basis.T).ravel()
        return command, control[-len(s) :].copy()


class Pieces:
    """The command of one axis for a target that comes in pieces of any length, from rest at 0."""

    def __init__(self, lpfbs: Lpfbs) -> None:
        self._lpfbs, self._s = lpfbs, lpfbs.rest
        self._preview = lpfbs.window.L_C - lpfbs.window.stride
        self._target = np.zeros(lpfbs.lead)  # for which the command is not final

    def feed(self, target: Array) -> Array:
        """Take more of the target (n,); return the command as far as the preview allows, (k,)."""
        self._target = np.concatenate([self._target, target])
        following = max(self._preview, self._lpfbs.lead)
        return self._windows((len(self._target) - following) // self._lpfbs.window.stride)

    def finish(self) -> Array:
        """Return what is left of the command; the target is at rest after its end."""
        n, stride = len(self._target) - self._lpfbs.lead, self._lpfbs.window.stride
        windows = -(-n // stride)
        missing = windows * stride + self._preview - len(self._target)
        if n and missing > 0:
            self._target = np.pad(self._target, (0, missing), mode="edge")
        return self._windows(windows)[:n]

    def _windows(self, count: int) -> Array:
        """Return the command of the next windows."""
        if count <= 0:
            return np.zeros(0)
        n = count * self._lpfbs.window.stride
        x_dm, self._s = self._lpfbs.run(self._target[: n + self._preview], self._s)
        self._target = self._target[n:].copy()  # a view would keep the whole array alive
        return x_dm


def _shrinks(A: Array) -> bool:
    """Return whether one of the first powers of A (d, d) has a norm below one.

    Then so has its spectral radius, which takes a hundred times as long to find.
    """
    for _ in range(5):  # those of printers shrink after 1 or 2
        A = A @ A
        if np.linalg.norm(A) < 1.0:
            return True
    return False


def _solve(G: ImpulseResponse, w: Window) -> tuple[Array, Array, Array]:
    """Return the gains of a window, p_C = K_target x_d + K_past s, and the step of s to the next.

    Minimises ‖x_d − Ñ_C p_C − Ñ_P s‖² + λ‖D(N_C p_C + N_P s)‖², D the second difference: eq. 39
    with the past exact and an effort penalty. Of p_C, the first n_up are kept; s, all control
    points in the response's reach, becomes step_past s, of which the last are K_target x_d more.
    Returns K_target (n_up, L_C), K_past (n_up, d), step_past (d, d). The rows of the plant come
    first, then those of its doubts.
    """
    _, _, D_P, D_C = window_splines(w)
    first = bsplines(
        w.L * np.arange(w.degree + 2, dtype=float), w.degree, np.arange(w.L * (w.degree + 1.0))
    )
    filters = [FiniteFilter(each, max(each.ahead, G.ahead)) for each in (G, *G.doubts)]
    padded = [np.pad(first[:, 0], (0, f.memory)) for f in filters]
    filtered = [f.run(u) for f, u in zip(filters, padded, strict=True)]
    longest = max(map(len, filtered))
    past = max(-(-longest // w.L) - 1, w.degree + 1)
    since = np.arange(w.L_C)[:, None] - w.L * np.arange(-past, w.n_C)
    since[(since < 0) | (since > longest)] = longest  # before a spline begins, as after its end
    N_filtered = np.vstack([np.pad(f, (0, longest + 1 - len(f)))[since] for f in filtered])
    D_past = np.pad(D_P, ((0, 0), (past - w.degree - 1, 0)))
    K_target, K_past = _gains(N_filtered[:, past:], D_C, N_filtered[:, :past], D_past, w)
    step_past = np.vstack([np.eye(past), K_past])[-past:]
    return K_target, K_past, step_past


def _gains(
    N_C_filtered: Array, D_C: Array, past_filtered: Array, D_past: Array, w: Window
) -> tuple[Array, Array]:
    """Return the gains K_target and K_past, from what moves the nozzle and what takes effort."""
    weight = np.sqrt(w.effort)
    pinv = pseudo_inverse(np.vstack([N_C_filtered, weight * D_C]), condition=1e12)
    if pinv is None:
        raise ArgumentError(
            f"the window is rank deficient: L = {w.L}, n_C = {w.n_C} leave control points "
            "without influence on the window; take smaller n_C or larger effort"
        )
    pinv = pinv[: w.n_up]
    free = np.vstack([past_filtered, weight * D_past])
    return pinv[:, : w.L_C], -product(pinv, free)
