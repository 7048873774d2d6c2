"""Racking, x_c and the sensor's rotation from one sensor at several places."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hframe_post.arrays import TS, Complex
from hframe_post.identification.estimation.frequency_response import FrequencyResponse
from hframe_post.identification.places import centre, line
from hframe_post.printer.settings import Printer

HZ = np.arange(3.0, 100.0, 0.25)
PLACES = [80.0, 110.0, 140.0, 170.0, 200.0]


def response(H: Complex, noise: float = 1e-30) -> FrequencyResponse:
    """Return a response. noise: power that the command does not explain, per its power."""
    signal = np.abs(H) ** 2
    return FrequencyResponse(HZ, H, signal / (signal + noise), np.ones(len(HZ)))


def responses_across(paper: Printer, x_c: float, psi: float) -> list[Complex]:
    plant, omega = paper.plant, 2.0 * np.pi * TS * HZ
    assert plant.Gxtheta is not None
    racking, x = plant.Gxtheta.response(omega), plant.Gxx.response(omega)
    return [(place - x_c) * racking + psi * x for place in PLACES]


@given(x_c=st.floats(50.0, 250.0), psi=st.floats(-0.1, 0.1))
def test_slope_centre_and_rotation_are_found(paper: Printer, x_c: float, psi: float) -> None:
    omega = 2.0 * np.pi * TS * HZ
    assert paper.plant.Gxtheta is not None
    fitted = line(PLACES, [response(H) for H in responses_across(paper, x_c, psi)])
    np.testing.assert_allclose(fitted.slope.H, paper.plant.Gxtheta.response(omega), atol=1e-12)
    found = centre(fitted, paper.plant.Gxx.response(omega))
    assert found == pytest.approx((x_c, psi), abs=1e-6)
    assert fitted.off < 1e-9


def test_each_place_but_the_middle_shows_the_slope(paper: Printer) -> None:
    fitted = line(PLACES, [response(H) for H in responses_across(paper, 140.0, 0.02)])
    assert [place for place, _ in fitted.by_place] == [80.0, 110.0, 170.0, 200.0]
    for _, alone in fitted.by_place:
        np.testing.assert_allclose(alone.H, fitted.slope.H, atol=1e-12)


def test_exchanged_places_are_off_the_line(paper: Printer) -> None:
    responses = [response(H) for H in responses_across(paper, 140.0, 0.0)]
    responses[0], responses[4] = responses[4], responses[0]
    assert line(PLACES, responses).off > 1.0


def test_noise_of_the_slope_follows_from_that_of_the_places(paper: Printer) -> None:
    noise, rng = 1e-4, np.random.default_rng(0)
    clean = responses_across(paper, 140.0, 0.0)
    assert paper.plant.Gxtheta is not None
    true = paper.plant.Gxtheta.response(2.0 * np.pi * TS * HZ)
    off = []
    for _ in range(20):
        errors = rng.normal(0.0, np.sqrt(noise / 2.0), (len(PLACES), len(HZ), 2)) @ [1.0, 1.0j]
        slope = line(PLACES, [response(H + e) for H, e in zip(clean, errors, strict=True)]).slope
        off.append(np.abs(slope.H - true) ** 2)
    fitted = line(PLACES, [response(H, noise) for H in clean]).slope
    expected = (1.0 / fitted.coherence - 1.0) * np.abs(fitted.H) ** 2
    assert np.mean(off) == pytest.approx(np.mean(expected), rel=0.1)
