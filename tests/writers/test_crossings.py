"""Where a sampled command crosses half steps, against scipy's splines and roots."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import CubicHermiteSpline

from hframe_post.arrays import Array, Integers
from hframe_post.writers.steps import crossings, spaced

SAMPLES = st.lists(
    st.floats(-40.0, 40.0) | st.sampled_from([0.0, 1.0, -1.0, 7.5]), min_size=4, max_size=40
)


def spline(u: Array) -> CubicHermiteSpline:
    """The monotone cubic, with tangents written out one by one."""
    m = []
    for before, here, after in zip(u, u[1:], u[2:], strict=False):
        left, right = here - before, after - here
        mean, most = (left + right) / 2.0, 3.0 * min(abs(left), abs(right))
        m.append(float(np.clip(mean, -most, most)) if left * right > 0.0 else 0.0)
    return CubicHermiteSpline(np.arange(len(m)), u[1:-1], m)


@settings(max_examples=100)
@given(SAMPLES)
def test_cubic_is_on_the_level_where_a_step_is_made(values: list[float]) -> None:
    u = np.array(values)
    interval, share, direction = crossings(u)
    assert ((share >= 0.0) & (share <= 1.0)).all()
    at = np.floor(u[1])
    for k, s, way, value in zip(
        interval, share, direction, spline(u)(interval + share), strict=True
    ):
        level = at + 1.0 if way > 0 else at
        assert value == pytest.approx(level, abs=2e-3), (k, s)
        at += way
    assert at == np.floor(u[-2])


def test_smooth_motion_is_followed_to_a_thousandth_of_a_step() -> None:
    """A sine's own crossings, between samples 1 ms apart."""
    t = np.arange(400)
    u = 300.25 * np.sin(t / 60.0)
    interval, share, _ = crossings(u)
    time = 1.0 + interval + share
    off = 300.25 * np.sin(time / 60.0)
    assert np.abs(off - np.rint(off)).max() < 1e-3


# ---------------------------------------------------------------------- on ticks


@st.composite
def due_steps(draw: st.DrawFn) -> tuple[Integers, Integers]:
    gaps = draw(st.lists(st.integers(0, 6), min_size=1, max_size=60))
    ways = draw(st.lists(st.sampled_from([1, -1]), min_size=len(gaps), max_size=len(gaps)))
    return np.cumsum(gaps), np.array(ways)


@given(due_steps(), st.integers(1, 9), st.integers(-5, 3), st.sampled_from([-1, 0, 1]))
def test_steps_are_as_early_as_spacing_allows(
    steps: tuple[Integers, Integers], gap: int, last: int, heading: int
) -> None:
    due, direction = steps
    expected, before, way = [], last, heading
    for tick, now in zip(due.tolist(), direction.tolist(), strict=True):
        turns = way != 0 and now != way
        before = max(tick, before + (gap if turns else 1))
        expected.append(before)
        way = now
    assert spaced(due, direction, gap, last, heading).tolist() == expected
