"""Impulse responses: the same as transfer functions where both can be, and two-sided ones."""

from __future__ import annotations

import numpy as np
import pytest

from hframe_post.errors import ArgumentError
from hframe_post.model.impulse_response import LONGEST, ImpulseResponse
from hframe_post.model.transfer_function import TransferFunction
from tests.modes import axis_mode, deviation_of_mode

OMEGA = np.linspace(0.0, 3.0, 100)


def test_a_long_response_is_the_transfer_function_that_it_was_made_from() -> None:
    G = axis_mode(40.0, 0.06)
    q = ImpulseResponse.from_transfer_function(G, 1900, rest=1.0)

    assert q.ahead == 0
    assert np.abs(q.response(OMEGA) - G.response(OMEGA)).max() < 1e-9  # of 1
    assert np.abs(q.impulse(1900) - G.impulse(1900)).max() < 1e-10  # of 1
    assert q.deviation == pytest.approx(deviation_of_mode(40.0, 0.06, 1900), abs=1e-9)  # µm


def test_a_lead_turns_the_phase_only() -> None:
    q = deviation_of_mode(40.0, 0.06, 400)
    causal, early = ImpulseResponse(q, 0), ImpulseResponse(q, 5)

    off = early.response(OMEGA) - 1.0 - np.exp(5j * OMEGA) * (causal.response(OMEGA) - 1.0)
    assert np.abs(off).max() < 1e-10  # of 1
    assert (causal.ahead, early.ahead) == (0, 5)
    assert ImpulseResponse(q + 1.0, 5).ahead == 6  # acceleration looks one sample ahead


def test_the_impulse_begins_as_early_as_the_response() -> None:
    rng = np.random.default_rng(1)
    G = ImpulseResponse(rng.normal(size=20), 7)

    h, late = G.impulse(40), np.arange(40) - G.ahead
    of_impulse = np.exp(-1j * OMEGA[:, None] * late) @ h
    assert np.abs(of_impulse - G.response(OMEGA)).max() < 1e-10  # of 1
    assert h.sum() == pytest.approx(1.0, abs=1e-12)
    assert len(G.impulse(3)) == 3


@pytest.mark.parametrize("factor", [1.05, 0.9, 1.3])
def test_a_stretched_response_has_lower_frequencies(factor: float) -> None:
    stretched = ImpulseResponse(deviation_of_mode(40.0, 0.06, 900), 0).stretched(factor)
    expected = axis_mode(40.0 / factor, 0.06)

    omega = OMEGA[(OMEGA > 0.0) & (OMEGA < 1.0)]  # below 160 Hz
    off = (stretched.response(omega) - expected.response(omega)) / omega**2
    assert stretched.ahead == 0
    assert np.abs(off).max() < 0.05  # µm, after 1000 mm/s² for 1 ms


def test_a_stretched_two_sided_response_keeps_its_middle() -> None:
    q = -np.exp(-0.5 * (np.arange(-30, 60) / 8.0) ** 2)
    stretched = ImpulseResponse(q, 30).stretched(1.1)

    j = np.arange(len(stretched.deviation)) - stretched.lead
    expected = -1.1 * np.exp(-0.5 * (j / 8.8) ** 2)
    assert np.abs(stretched.deviation - expected)[1:-1].max() < 0.01  # µm


@pytest.mark.parametrize(
    ("deviation", "lead", "rest"),
    [
        ([], 0, 1.0),
        ([[0.0]], 0, 1.0),
        ([0.0, np.nan], 0, 1.0),
        ([0.0, np.inf], 0, 1.0),
        ([0.0, 1.0], 2, 1.0),
        ([0.0, 1.0], -1, 1.0),
        ([0.0, 1.0], 0, np.nan),
        (np.zeros(LONGEST + 1), 0, 1.0),
    ],
)
def test_an_impossible_response_is_refused(deviation: list[float], lead: int, rest: float) -> None:
    with pytest.raises(ArgumentError):
        ImpulseResponse(np.array(deviation), lead, rest)


def test_no_response_is_gain_at_rest_alone() -> None:
    nothing = ImpulseResponse(np.zeros(3), 2)

    assert nothing.ahead == 0
    assert np.array_equal(nothing.response(OMEGA), np.ones(len(OMEGA)))
    assert np.array_equal(nothing.impulse(2), [1.0, 0.0])
    assert isinstance(axis_mode(40.0, 0.06), TransferFunction)
