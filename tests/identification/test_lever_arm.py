"""Racking, x_c and the sensor's turn from what one sensor hears at several places."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hframe_post.arrays import TS, Complex
from hframe_post.identification.responses.frequency_response import FrequencyResponse
from hframe_post.identification.responses.lever_arm import centre, line
from hframe_post.printer.settings import Printer

HZ = np.arange(3.0, 100.0, 0.25)
PLACES = [80.0, 110.0, 140.0, 170.0, 200.0]


def response(H: Complex, noise: float = 1e-30) -> FrequencyResponse:
    """noise: power of what the command does not explain, per power of the command."""
    signal = np.abs(H) ** 2
    return FrequencyResponse(HZ, H, signal / (signal + noise), np.ones(len(HZ)))


def heard(paper: Printer, x_c: float, psi: float) -> list[Complex]:
    plant, omega = paper.plant, 2.0 * np.pi * TS * HZ
    assert plant.Gxtheta is not None
    racking, x = plant.Gxtheta.response(omega), plant.Gxx.response(omega)
    return [(place - x_c) * racking + psi * x for place in PLACES]


@given(x_c=st.floats(50.0, 250.0), psi=st.floats(-0.1, 0.1))
def test_slope_centre_and_turn_are_found(paper: Printer, x_c: float, psi: float) -> None:
    omega = 2.0 * np.pi * TS * HZ
    assert paper.plant.Gxtheta is not None
    told = line(PLACES, [response(H) for H in heard(paper, x_c, psi)])
    np.testing.assert_allclose(told.slope.H, paper.plant.Gxtheta.response(omega), atol=1e-12)
    found = centre(told, paper.plant.Gxx.response(omega))
    assert found == pytest.approx((x_c, psi), abs=1e-6)
    assert told.off < 1e-9


def test_each_place_but_the_middle_tells_the_slope(paper: Printer) -> None:
    told = line(PLACES, [response(H) for H in heard(paper, 140.0, 0.02)])
    assert [place for place, _ in told.by_place] == [80.0, 110.0, 170.0, 200.0]
    for _, alone in told.by_place:
        np.testing.assert_allclose(alone.H, told.slope.H, atol=1e-12)


def test_places_that_are_exchanged_are_off_the_line(paper: Printer) -> None:
    responses = [response(H) for H in heard(paper, 140.0, 0.0)]
    responses[0], responses[4] = responses[4], responses[0]
    assert line(PLACES, responses).off > 1.0


def test_noise_of_the_slope_is_that_of_the_places_over_their_arms(paper: Printer) -> None:
    noise, rng = 1e-4, np.random.default_rng(0)
    clean = heard(paper, 140.0, 0.0)
    assert paper.plant.Gxtheta is not None
    true = paper.plant.Gxtheta.response(2.0 * np.pi * TS * HZ)
    off = []
    for _ in range(20):
        errors = rng.normal(0.0, np.sqrt(noise / 2.0), (len(PLACES), len(HZ), 2)) @ [1.0, 1.0j]
        slope = line(PLACES, [response(H + e) for H, e in zip(clean, errors, strict=True)]).slope
        off.append(np.abs(slope.H - true) ** 2)
    told = line(PLACES, [response(H, noise) for H in clean]).slope
    expected = (1.0 / told.coherence - 1.0) * np.abs(told.H) ** 2
    assert np.mean(off) == pytest.approx(np.mean(expected), rel=0.1)
