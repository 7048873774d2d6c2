"""Printers drawn around the model: repeatable, at rest as they were."""

from itertools import pairwise

import numpy as np
import pytest

from hframe_post.arrays import Array
from hframe_post.model.impulse_response import ImpulseResponse
from hframe_post.model.plant import Plant
from hframe_post.printer import profile
from hframe_post.studies.uncertainty import draws

PLANT = profile.load("paper").plant
CARTESIAN = profile.load("example-cartesian").plant


def responses(plant: Plant) -> list[ImpulseResponse]:
    return [G for G in (plant.Gxx, plant.Gyy, plant.Gxtheta) if G is not None]


def same(one: Plant, other: Plant) -> bool:
    return one.x_c == other.x_c and all(
        np.array_equal(G.deviation, H.deviation) and G.lag == H.lag
        for G, H in zip(responses(one), responses(other), strict=True)
    )


def test_equal_seeds_give_equal_printers_and_others_do_not() -> None:
    first, again = (draws(PLANT, 0.05, 8, seed=1) for _ in range(2))
    assert all(same(a, b) for a, b in zip(first, again, strict=True))
    assert not any(same(a, b) for a, b in zip(first, draws(PLANT, 0.05, 8, 2), strict=True))
    assert not any(same(a, b) for a, b in pairwise(first))


@pytest.mark.parametrize("plant", [PLANT, CARTESIAN], ids=["hbot", "cartesian"])
def test_no_model_error_is_the_plant_itself(plant: Plant) -> None:
    for drawn in draws(plant, 0.0, 3, seed=0):
        assert (drawn.x_c, drawn.Gxtheta is None) == (plant.x_c, plant.Gxtheta is None)
        assert same(drawn, plant)


def test_parameters_are_uniform_within_the_share() -> None:
    share, count = 0.05, 400
    off = (lengths(share, count) - 1.0) / share
    assert np.abs(off).max() <= 1.1
    assert np.abs(off).max(axis=0).min() > 0.9
    quartiles = np.quantile(off, [0.25, 0.5, 0.75], axis=0)
    np.testing.assert_allclose(quartiles, np.array([[-0.5], [0.0], [0.5]]).repeat(2, 1), atol=0.2)


def lengths(share: float, count: int) -> Array:
    """Return how many times as long the axes' responses are, (count, 2)."""
    drawn = draws(CARTESIAN, share, count, seed=3)
    own = [len(CARTESIAN.Gxx.deviation), len(CARTESIAN.Gyy.deviation)]
    return np.array([[len(p.Gxx.deviation), len(p.Gyy.deviation)] for p in drawn]) / own
