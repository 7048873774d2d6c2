"""A sensor's gains from its readings at rest, turned several ways."""

from __future__ import annotations

import numpy as np
import pytest

from hframe_post.arrays import Array
from hframe_post.errors import IdentificationError
from hframe_post.identification.recordings.accelerometer import (
    GRAVITY,
    gains_along_printer,
    gains_at_rest,
)

GAINS, OFFSET = np.array([1.04, 0.97, 1.01]), np.array([120.0, -80.0, 250.0])


def turned(noise: float = 0.0) -> Array:
    """Return six readings, not quite along the axes."""
    rng = np.random.default_rng(2)
    up = np.concatenate([np.eye(3), -np.eye(3)]) + rng.normal(0.0, 0.1, (6, 3))
    up /= np.linalg.norm(up, axis=1)[:, None]
    return np.asarray(GRAVITY * up * GAINS + OFFSET + noise * rng.normal(size=(6, 3)))


def test_gains_are_found_whatever_offset_and_tilt() -> None:
    assert gains_at_rest(turned()) == pytest.approx(GAINS, abs=1e-6)
    assert gains_at_rest(turned(20.0)) == pytest.approx(GAINS, abs=0.005)


def test_gains_follow_the_axis_map() -> None:
    assert gains_along_printer(GAINS, "x=-y,y=x,z=z") == (0.97, 1.04)


def test_readings_that_do_not_show_the_gains_are_refused() -> None:
    with pytest.raises(IdentificationError, match="once and down once"):
        gains_at_rest(turned()[:5])
    with pytest.raises(IdentificationError, match="15 % off"):
        gains_at_rest(turned() * 1.3)
