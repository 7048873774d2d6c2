"""Warnings about a fit: its order."""

from __future__ import annotations

from hframe_post.identification.fitting.fit import check_order


def test_a_residual_above_the_noise_costs_a_warning() -> None:
    assert check_order(3, 1.5) == []
    assert "order 3 leaves 9.0 times" in check_order(3, 9.0)[0]
