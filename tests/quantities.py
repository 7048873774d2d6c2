"""Checks whose failure names the quantity and its unit."""

import numpy as np

from hframe_post.arrays import Array


def below(value: float, bound: float, quantity: str) -> None:
    """Check that a quantity, named with its unit, is less than a bound."""
    assert value < bound, f"{quantity}: {value:.5g}, not below {bound:g}"


def near(value: float, wanted: float, tolerance: float, quantity: str) -> None:
    """Check that a quantity, named with its unit, is what is wanted, within a tolerance."""
    off = abs(value - wanted)
    assert off <= tolerance, f"{quantity}: {value:.9g}, not {wanted:.9g} ± {tolerance:g}"


def rms(x: Array) -> float:
    """Return the root of the mean square, 0 of nothing."""
    return float(np.sqrt(np.square(x).mean())) if len(x) else 0.0
