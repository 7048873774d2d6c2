"""Warnings about a fit: its order and its zeros."""

from __future__ import annotations

import numpy as np
import pytest

from hframe_post.identification.fitting.fit import check_order, check_zeros
from hframe_post.model.transfer_function import TransferFunction
from tests.plants import resonant


def test_a_residual_above_the_noise_costs_a_warning() -> None:
    assert check_order(3, 1.5) == []
    assert "order 3 is too low" in check_order(3, 9.0)[0]


@pytest.mark.parametrize(("zero", "count"), [(1.2, 0), (1.02, 1), (-1.02, 0), (0.9, 0)])
def test_zeros_just_outside_the_unit_circle_cost_a_warning(zero: float, count: int) -> None:
    """What cancels a zero at 1.02 decays by 2 % a sample, backwards in time.

    A zero at −1.02 does not matter: nothing is commanded at 500 Hz.
    """
    G = TransferFunction(np.array([zero]), resonant(50.0, 0.2).poles, 1.0)
    warnings = check_zeros(G)
    assert len(warnings) == count
    if warnings:
        assert f"{np.log(100.0) / np.log(zero):.0f} ms early" in warnings[0]
