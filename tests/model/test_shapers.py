"""Input shapers: the properties that define each of them."""

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hframe_post.errors import HframeError
from hframe_post.model.shapers import compared, most_damping, shaper


@given(st.sampled_from(compared()), st.floats(10.0, 150.0), st.floats(0.0, 1.0))
def test_a_shaper_is_a_mean_without_delay(name: str, hz: float, share: float) -> None:
    s = shaper(name, hz, share * min(0.5, most_damping(name)))
    assert (s.A >= 0.0).all()
    assert s.A.sum() == pytest.approx(1.0)
    assert pytest.approx(0.0, abs=1e-12) == s.A @ s.T
    taps = s.taps()
    assert taps.sum() == pytest.approx(1.0)
    assert (np.arange(len(taps)) - s.reach) @ taps == pytest.approx(0.0, abs=1e-9)


KLIPPER = {  # amplitudes, and times (ms), of Klipper in August 2026 at 40 Hz and ζ = 0.1
    "mzv": ([0.36513, 0.40749, 0.22738], [0.0, 9.4222, 18.8445]),
    "mzv(n=5,t=1.1)": (
        [0.15844, 0.279, 0.28632, 0.19714, 0.0791],
        [0.0, 6.9096, 13.8193, 20.7289, 27.6385],
    ),
    "ei": ([0.35488, 0.453, 0.19212], [0.0, 12.681, 25.1259]),
    "2hump_ei": ([0.25854, 0.35994, 0.27276, 0.10877], [0.0, 12.8976, 25.2052, 37.2232]),
    "3hump_ei": (
        [0.22085, 0.27721, 0.2597, 0.16706, 0.07518],
        [0.0, 13.5125, 25.7013, 37.6475, 49.5732],
    ),
}


@pytest.mark.parametrize(("name", "pulses"), KLIPPER.items())
def test_pulses_are_those_of_klipper(name: str, pulses: tuple[list[float], list[float]]) -> None:
    s = shaper(name, 40.0, 0.1)
    np.testing.assert_allclose(s.A, pulses[0], atol=1e-5)
    np.testing.assert_allclose(1e3 * (s.T - s.T[0]), pulses[1], atol=1e-4)


@pytest.mark.parametrize(
    ("name", "damping", "message"),
    [
        ("ei", 0.41, "at most 0.4"),
        ("3hump_ei", 0.524, "at most 0.2"),
        ("mzv(n=2,t=0.4)", 0.1, "n must be at least 3"),
        ("mzv(n=3,t=1)", 0.1, "t below"),
        ("mzv(n=4,t=0.4)", 0.1, "negative"),
        ("mzv(n=x)", 0.1, "'n=x' is not one of n=…, t=…"),
        ("zv(n=3)", 0.1, "'n=3' is not one of none"),
    ],
)
def test_what_klipper_refuses_is_an_error(name: str, damping: float, message: str) -> None:
    with pytest.raises(HframeError, match=re.escape(message)):
        shaper(name, 40.0, damping)
