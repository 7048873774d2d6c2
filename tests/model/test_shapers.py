"""Input shapers: the properties that define each of them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hframe_post.arrays import TS, Array
from hframe_post.errors import HframeError
from hframe_post.model.shapers import SHAPERS, TOLERATED, shaper


@pytest.mark.parametrize("name", SHAPERS)
@given(hz=st.floats(10.0, 150.0), damping=st.floats(0.0, 0.5))
def test_a_shaper_is_a_mean_without_delay(name: str, hz: float, damping: float) -> None:
    s = shaper(name, hz, damping)
    assert (s.A > 0.0).all()
    assert s.A.sum() == pytest.approx(1.0)
    assert pytest.approx(0.0, abs=1e-12) == s.A @ s.T
    taps = s.taps()
    assert taps.sum() == pytest.approx(1.0)
    assert (np.arange(len(taps)) - s.reach) @ taps == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("name", ["zv", "mzv", "2hump_ei", "zvd", "zvdd", "zvddd"])
@pytest.mark.parametrize("damping", [0.0, 0.1, 0.3])
def test_these_cancel_their_mode(name: str, damping: float) -> None:
    assert shaper(name, 40.0, damping).residual(np.array([40.0]), damping)[0] < 1e-9


@pytest.mark.parametrize("name", ["smooth_zv", "smooth_zvd"])
def test_means_cancel_an_undamped_mode(name: str) -> None:
    s = shaper(name, 40.0, 0.0)
    assert s.residual(np.array([40.0]), 0.0)[0] < 1e-9
    assert np.ptp(s.T) * 40.0 == pytest.approx(
        {"smooth_zv": 1.0, "smooth_zvd": 2.0}[name], rel=0.02
    )


@pytest.mark.parametrize("name", ["ei", "3hump_ei"])
def test_these_leave_the_tolerated_ringing_over_a_wider_band(name: str) -> None:
    s = shaper(name, 40.0, 0.0)
    assert s.residual(np.array([40.0]), 0.0)[0] == pytest.approx(TOLERATED)
    off = np.linspace(36.0, 44.0, 41)
    zv = shaper("zv", 40.0, 0.0).residual(off, 0.0)
    assert s.residual(off, 0.0).max() <= TOLERATED + 1e-9
    assert zv.max() > 3.0 * TOLERATED


@pytest.mark.parametrize("name", SHAPERS)
def test_a_mode_shaken_by_the_command_is_left_with_the_residual(name: str) -> None:
    """An undamped mode, integrated: its amplitude after a step over that of the bare step."""
    s, mode = shaper(name, 30.0, 0.0), 33.0
    path = np.repeat([0.0, 1.0], [200, 400])
    t, omega = np.arange(600) * TS, 2.0 * np.pi * mode

    def amplitude(command: Array) -> float:
        kicks = np.diff(command, prepend=0.0)
        return float(abs((kicks * np.exp(1j * omega * t)).sum()))

    left = amplitude(s.run(path)) / amplitude(path)
    assert left == pytest.approx(s.residual(np.array([mode]), 0.0)[0], abs=0.01)


def test_a_command_is_the_path_where_it_stands_or_runs_evenly() -> None:
    path = np.concatenate([np.zeros(100), np.linspace(0.0, 10.0, 200), np.full(100, 10.0)])
    s = shaper("mzv", 40.0, 0.1)
    command = s.run(path)
    reach = s.reach
    np.testing.assert_allclose(command[: 100 - reach], 0.0, atol=1e-12)
    np.testing.assert_allclose(command[100 + reach : 300 - reach], path[100 + reach : 300 - reach])
    np.testing.assert_allclose(command[300 + reach :], 10.0)


def test_an_unknown_shaper_is_an_error() -> None:
    with pytest.raises(HframeError, match="zv, mzv"):
        shaper("zw", 40.0, 0.1)
