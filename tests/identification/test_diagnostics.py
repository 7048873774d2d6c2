"""What is said of a fit: order, delay, resonances outside the band, zeros, poor data."""

from __future__ import annotations

import numpy as np
import pytest

from hframe_post.identification.diagnostics import of_zeros
from hframe_post.identification.fit import fit
from hframe_post.identification.frequency_response import FrequencyResponse
from hframe_post.model.transfer_function import TransferFunction
from tests.identification.test_fit import BAND, NARROW, measured
from tests.plants import all_of_them, at_rest, resonant


def texts(G: TransferFunction, order: int | None = None, **options: float) -> str:
    return "\n".join(fit(measured(G, **options), order, at_rest(G), BAND, NARROW).warnings)


def test_diagnosis_of_the_order() -> None:
    G = all_of_them()[1]
    assert "order 3 is too low" in texts(G, 3, noise=0.01)
    assert "order 8 is too high" in texts(resonant(40.0, 0.1), 8, noise=0.01)
    assert "order" not in texts(G, noise=0.01)


def test_diagnosis_of_the_delay() -> None:
    assert "delay of 0.2 ms is at its bound" in texts(all_of_them()[0], 4, delay=1e-3)


def test_diagnosis_of_resonances_outside_the_band() -> None:
    G = resonant(130.0, 0.05)
    found = fit(measured(G), 2, 1.0, BAND)
    assert any("a resonance at 130 Hz" in text for text in found.warnings)
    assert "resonance" not in texts(resonant(60.0, 0.05), 2)


def test_diagnosis_of_zeros_outside_the_circle_cost_their_delay() -> None:
    """An all-pass (1 − bz)/(z − b) delays by (1 + b)/(1 − b) samples at rest."""
    b = 0.5
    first = resonant(50.0, 0.2)
    G = TransferFunction(np.array([1.0 / b]), np.append(first.poles, b), -b * first.gain)
    assert at_rest(G) == 1.0
    found = fit(measured(G), 3, 1.0, BAND)
    (text,) = found.notes
    near = found.G.zeros[np.abs(found.G.zeros) < 3.0]
    assert near == pytest.approx([1.0 / b], rel=1e-3)
    assert "3 ms of group delay" in text


def test_zeros_that_hardly_lie_outside_the_circle_cost_a_warning() -> None:
    """What cancels a zero at 1.02 decays by 2 % a sample, backwards in time."""
    poles = resonant(50.0, 0.2).poles
    usual, near = (TransferFunction(np.array([zero]), poles, 1.0) for zero in (1.2, 1.02))
    assert [len(texts) for texts in of_zeros(usual)] == [1, 0]
    notes, warnings = of_zeros(near)
    assert notes == ()
    assert f"{np.log(100.0) / np.log(1.02):.0f} ms early" in warnings[0]


def test_diagnosis_of_the_data() -> None:
    response = measured(resonant(40.0, 0.1), 0.01)
    gamma = np.where((response.hz < 3.0) | (response.hz > 90.0), 0.5, response.coherence)
    poor = FrequencyResponse(response.hz, response.H, gamma, response.power)
    assert "below 0.8 under 3 Hz, over 90 Hz" in fit(poor, 2, 1.0, BAND).warnings[0]
