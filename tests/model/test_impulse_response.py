"""Impulse responses: the same as transfer functions where both can be, and two-sided ones."""

from typing import Any

import numpy as np
import pytest

from hframe_post.errors import ArgumentError
from hframe_post.model.impulse_response import ImpulseResponse
from tests.modes import axis_mode, damped_by_the_frame, deviation_of_mode

OMEGA = np.linspace(0.0, 3.0, 100)


def test_a_long_response_is_the_transfer_function_that_it_was_made_from() -> None:
    G = axis_mode(40.0, 0.06)
    q = ImpulseResponse.from_transfer_function(G, 1.0)

    assert q.ahead == 0
    assert np.abs(q.response(OMEGA) - G.response(OMEGA)).max() < 2e-4  # of 1
    assert np.abs(q.impulse(1900) - G.impulse(1900)).max() < 1e-4  # of 1
    expected = deviation_of_mode(40.0, 0.06, len(q.deviation))
    assert q.deviation == pytest.approx(expected, abs=1e-9)  # µm


@pytest.mark.parametrize("factor", [1.05, 0.9, 1.3])
def test_a_stretched_response_has_lower_frequencies(factor: float) -> None:
    stretched = ImpulseResponse(deviation_of_mode(40.0, 0.06, 900), 0).stretched(factor)
    expected = axis_mode(40.0 / factor, 0.06)

    omega = OMEGA[(OMEGA > 0.0) & (OMEGA < 1.0)]  # below 160 Hz
    off = (stretched.response(omega) - expected.response(omega)) / omega**2
    assert stretched.ahead == 0
    assert np.abs(off).max() < 0.05  # µm, after 1000 mm/s² for 1 ms


@pytest.mark.parametrize("lead", [0, 7])
def test_a_lag_is_how_late_the_nozzle_is_at_a_constant_speed(lead: int) -> None:
    G = ImpulseResponse(np.random.default_rng(1).normal(size=20), lead, lag=2.3)

    h, late = G.impulse(40), np.arange(40) - G.ahead
    of_impulse = np.exp(-1j * OMEGA[:, None] * late) @ h
    assert np.abs(of_impulse - G.response(OMEGA)).max() < 1e-10  # of 1
    assert h.sum() == pytest.approx(1.0, abs=1e-12)
    assert h @ late == pytest.approx(2.3, abs=1e-10)  # samples
    assert ImpulseResponse(np.zeros(1), 0, lag=2.3).impulse(3) == pytest.approx([-1.3, 2.3, 0.0])


def test_a_damper_against_the_frame_is_a_lag() -> None:
    """A mode of ω and ζ that the frame damps lags by 2ζ/ω."""
    G = damped_by_the_frame(18.0, 0.13)
    q = ImpulseResponse.from_transfer_function(G, 1.0)

    omega = 2.0 * np.pi * 18.0 * 1e-3
    assert q.lag == pytest.approx(2.0 * 0.13 / omega + 1.0, abs=0.01)  # ms, one of them a delay
    assert np.abs(q.response(OMEGA) - G.response(OMEGA)).max() < 2e-4  # of 1
    assert np.abs(q.impulse(1900) - G.impulse(1900)).max() < 1e-4  # of 1


def test_a_stretched_response_lags_as_much_longer() -> None:
    G = ImpulseResponse(
        deviation_of_mode(40.0, 0.06, 900), 0, lag=2.0, drift=0.02,
        unknown=0.1 * deviation_of_mode(60.0, 0.2, 300),
    )  # fmt: skip
    longer = G.stretched(1.25)

    assert (longer.lag, longer.drift) == (2.5, 0.02)
    expected = 0.1 * deviation_of_mode(48.0, 0.2, len(longer.unknown))
    assert np.abs(longer.unknown - expected).max() < 0.01  # µm, of 0.3
    slow = np.array([1e-3])
    assert longer.response(slow) == pytest.approx(G.response(1.25 * slow), abs=1e-5)  # of 1


@pytest.mark.parametrize(
    "bad",
    [{"deviation": []}, {"deviation": [0.0, np.inf]}, {"lead": 2}, {"rest": np.nan},
     {"drift": 1.0}, {"unknown": np.zeros((2, 2))}],
)  # fmt: skip
def test_an_impossible_response_is_refused(bad: dict[str, Any]) -> None:
    with pytest.raises(ArgumentError, match=next(iter(bad))):
        ImpulseResponse(**{"deviation": np.array([0.0, 1.0]), "lead": 0, **bad})
