"""B-splines and the limited preview: equations, certificate, exact past."""

import numpy as np
import pytest
from scipy.interpolate import BSpline

from hframe_post.arrays import Array
from hframe_post.model.lpfbs import Lpfbs, Window, bsplines
from hframe_post.printer import profile
from tests.plants import Filter

PLANT = profile.load("paper").plant


@pytest.mark.paper
@pytest.mark.parametrize("degree", [2, 3, 5])
def test_eq_6_basis_functions(degree: int) -> None:
    knots = np.concatenate([np.zeros(degree), np.linspace(0, 1, 8), np.ones(degree)])
    t = np.linspace(0, 1, 101)
    expected = BSpline.design_matrix(t, knots, degree).toarray()
    np.testing.assert_allclose(bsplines(knots, degree, t), expected, atol=1e-12)


@pytest.mark.parametrize(
    ("L", "n_C", "n_up", "effort"), [(20, 11, 5, 0.0), (10, 14, 7, 0.0), (20, 11, 5, 1.0)]
)
def test_diverging_windows_are_refused(L: int, n_C: int, n_up: int, effort: float) -> None:
    with pytest.raises(ValueError, match="diverges: spectral radius"):
        Lpfbs(PLANT.Gxx, Window(L, n_C, n_up, effort))


@pytest.mark.parametrize("n", [1, 219, 220, 441, 2000])
def test_command_takes_any_length_and_is_that_of_whole_windows(n: int) -> None:
    solver = Lpfbs(PLANT.Gyy, Window(5, 88, 44, 100.0))
    rng = np.random.default_rng(n)
    x_d = 100.0 + np.cumsum(rng.normal(size=n)) * 0.01
    command = solver.command(x_d)
    assert command.shape == (n,)
    long = np.concatenate([x_d, np.full(solver.window.stride * 30 - n, x_d[-1])])
    np.testing.assert_allclose(command, solver.command(long)[:n], atol=1e-9)
    nozzle = 100.0 + Filter(PLANT.Gyy).run(solver.command(long) - 100.0)
    assert abs(nozzle[-1] - x_d[-1]) < 0.01  # it arrives, from where the axis stood


@pytest.mark.paper
def test_eq_30_minimises_error_and_effort_in_its_window() -> None:
    """No other control points of the first window do better from rest."""
    window = Window(10, 22, 22, 30.0)
    solver = Lpfbs(PLANT.Gxx, window)
    t = np.arange(window.L_C)
    x_d = 5 * (1 - np.cos(np.pi * np.minimum(t, 150) / 150)) / 2
    x_dm, _ = solver.run(x_d, solver.rest)

    def cost(command: Array) -> float:
        error = x_d - Filter(PLANT.Gxx).run(command)
        bend = np.diff(command, n=2, prepend=[0.0, 0.0])
        return float(error @ error + window.effort * bend @ bend)

    knots = np.arange(-50, 10 * (23 + 5), 10, dtype=np.float64)
    N = bsplines(knots, 5, t.astype(float))[:, 5:27]
    best = cost(x_dm)
    rng = np.random.default_rng(1)
    for scale in (1e-1, 1e-3):
        for _ in range(50):
            assert cost(x_dm + N @ rng.normal(size=22) * scale) > best
