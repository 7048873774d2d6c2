"""Junction speeds are those of Klipper; motion from speed to speed keeps its limits."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hframe_post.arrays import TS
from hframe_post.firmware.motion import travelled
from hframe_post.model.kinematics import Trapezoid

LENGTHS = st.floats(0.01, 100.0)
SHARES = st.floats(0.0, 1.0)


@st.composite
def trapezoids(draw: st.DrawFn) -> Trapezoid:
    """Return feasible ones: both end speeds are reached within half of the length."""
    length, cruise, a = draw(LENGTHS), draw(st.floats(1.0, 100.0)), draw(st.floats(10.0, 5000.0))
    most = min(cruise, math.sqrt(length * a / 2.0))
    return Trapezoid(length, cruise, a, draw(SHARES) * most, draw(SHARES) * most)


@given(trapezoids(), st.floats(1.0, 3.0))
def test_a_motion_is_complete_and_within_its_limits(motion: Trapezoid, longer: float) -> None:
    for one in (motion, motion.slowed_to(longer * motion.seconds)):
        t = np.linspace(0.0, one.seconds, 4001)
        s = one.distance(t)
        assert s[0] == 0.0
        assert s[-1] == pytest.approx(one.length, rel=1e-9)
        v = np.diff(s) / np.diff(t)
        assert v.max() <= one.cruise * (1.0 + 1e-6)
        assert np.abs(np.diff(v) / np.diff(t)[1:]).max() <= one.acceleration * 1.01
        assert v[0] == pytest.approx(one.v_s, abs=2.0 * one.acceleration * t[1])
        assert v[-1] == pytest.approx(one.v_e, abs=2.0 * one.acceleration * t[1])


def test_a_motion_is_never_sped_up() -> None:
    motion = Trapezoid(1.0, 20.0, 500.0, 2.0, 0.0)
    assert motion.slowed_to(0.5 * motion.seconds) is motion


@given(trapezoids())
def test_moves_are_played_as_trapezoids(motion: Trapezoid) -> None:
    v_s, v_e = (np.array([v]) for v in (motion.v_s, motion.v_e))
    d, v = np.array([motion.length]), np.array([motion.cruise])
    s = travelled(np.append(d, d), np.append(v, v), np.append(v_s, v_e), np.append(v_e, v_s),
                  motion.acceleration)  # fmt: skip
    t = np.asarray(TS * np.arange(len(s)), dtype=np.float64)
    back = motion.length - motion.distance(2.0 * motion.seconds - t)
    expected = np.where(t < motion.seconds, motion.distance(t), motion.length + back)
    np.testing.assert_allclose(s, expected, atol=1e-6)
