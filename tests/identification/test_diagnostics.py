"""What is said of a fit: order, delay, resonances outside the band, zeros."""

from __future__ import annotations

import numpy as np
import pytest

from hframe_post.identification.fitting.checks import of_delay, of_order, of_roots, of_zeros
from hframe_post.model.transfer_function import TransferFunction
from tests.plants import at_rest, resonant

BAND = (1.0, 100.0)


def test_an_order_is_too_low_where_the_noise_does_not_explain_the_rest() -> None:
    assert of_order(3, 1.5) == []
    assert "order 3 is too low" in of_order(3, 9.0)[0]


def test_a_delay_at_its_bound() -> None:
    assert of_delay(0.0, (-2e-3, 2e-3)) == []
    assert "delay of 2 ms is at its bound" in of_delay(2e-3, (-2e-3, 2e-3))[0]
    assert of_delay(2e-4, (-2e-4, 2e-4)) == []  # no more than a sample of the sensor


def test_resonances_outside_the_band() -> None:
    assert of_roots(resonant(60.0, 0.05), BAND) == []
    assert "a resonance at 130 Hz" in of_roots(resonant(130.0, 0.05), BAND)[0]


def test_zeros_outside_the_circle_cost_their_delay() -> None:
    """An all-pass (1 − bz)/(z − b) delays by (1 + b)/(1 − b) samples at rest."""
    b = 0.5
    first = resonant(50.0, 0.2)
    G = TransferFunction(np.array([1.0 / b]), np.append(first.poles, b), -b * first.gain)
    assert at_rest(G) == 1.0
    (text,), warnings = of_zeros(G)
    assert "3 ms of group delay" in text
    assert warnings == ()


@pytest.mark.parametrize(("zero", "told"), [(1.2, (1, 0)), (1.02, (0, 1)), (-1.02, (1, 0))])
def test_zeros_that_hardly_lie_outside_the_circle_cost_a_warning(
    zero: float, told: tuple[int, int]
) -> None:
    """What cancels a zero at 1.02 decays by 2 % a sample, backwards in time.

    One at −1.02 is that of a delay's fraction of a sample: nothing is commanded at 500 Hz.
    """
    notes, warnings = of_zeros(TransferFunction(np.array([zero]), resonant(50.0, 0.2).poles, 1.0))
    assert (len(notes), len(warnings)) == told
    if warnings:
        assert f"{np.log(100.0) / np.log(zero):.0f} ms early" in warnings[0]
