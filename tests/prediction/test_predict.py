"""Prediction: the exact plant, and the distance to the path."""

import numpy as np
import pytest

from examples.paper.tables import transfer_functions
from hframe_post.arrays import Array, Integers
from hframe_post.model.nozzle import Response
from hframe_post.model.strategies import Compensator
from hframe_post.native.stop import NEAREST
from hframe_post.prediction.predict import contour_error, judge
from hframe_post.stream.types import Samples
from tests.plants import Filter


@pytest.mark.paper
def test_eq_1_and_2_racking_at_the_actual_x(compensator: Compensator) -> None:
    plant = compensator.plant
    assert plant.Gxtheta is not None
    rng = np.random.default_rng(0)
    command = np.cumsum(rng.normal(size=(800, 2)), axis=0) * 0.05 + [200.0, 80.0]
    command[0] = [200.0, 80.0]

    def through(name: str, u: Array) -> Array:
        return Filter(transfer_functions()[name]).run(u)

    u = command - command[0]
    x = 200.0 + through("Gxx", u[:, 0])
    theta = through("Gxtheta", u[:, 0])
    y = 80.0 + through("Gyy", u[:, 1]) + (x - plant.x_c) * theta
    got = Response(plant, command[0]).run(command)
    off = np.abs(got - np.column_stack([x, y])).max()
    assert off < 5e-5  # mm: responses end at 1e-5 of themselves


def brute_force(path: Array, actual: Array, at: Integers, reach: int) -> Array:
    """Distance of each point to the polyline through the samples within ``reach``."""
    distances = []
    for point, k in zip(actual, at, strict=True):
        low, high = max(k - reach, 0), min(k + reach, len(path) - 1)
        start, along = path[low:high], np.diff(path[low : high + 1], axis=0)
        length2 = np.maximum((along**2).sum(axis=1), 1e-30)
        share = np.clip(((point - start) * along).sum(axis=1) / length2, 0, 1)
        distances.append(np.hypot(*(point - start - share[:, None] * along).T).min())
    return np.array(distances)


def broken_line(seed: int) -> Array:
    """Straight strokes with sharp corners, a curve and a rest, 1 ms apart."""
    rng = np.random.default_rng(seed)
    turns = np.repeat(rng.uniform(-np.pi, np.pi, 12), 60)
    turns[200:330] += np.linspace(0, 4, 130)
    speed = 0.06 * np.abs(np.sin(np.arange(720) * np.pi / 60)) + 0.004
    speed[400:430] = 0.0
    return 100 + np.cumsum(np.column_stack([np.cos(turns), np.sin(turns)]) * speed[:, None], axis=0)


@pytest.mark.parametrize("every", [1, 2, 3])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_contour_error_is_the_distance_to_the_path(seed: int, every: int) -> None:
    path = broken_line(seed)
    rng = np.random.default_rng(seed)
    at = np.arange(30, len(path) - 30, every)
    wobble = np.cumsum(rng.normal(size=(len(path), 2)), axis=0) * 2e-4
    got, actual = contour_error(path, path + wobble, at), (path + wobble)[at]
    widest = brute_force(path, actual, at, NEAREST + 2)
    assert (got >= widest - 1e-12).all()
    assert (got <= np.hypot(*(actual - path[at]).T) + 1e-12).all()
    assert np.sqrt((got**2).mean()) <= 1.02 * np.sqrt((widest**2).mean())


def test_lag_along_the_path_is_not_a_contour_error() -> None:
    path = np.column_stack([np.arange(400) * 0.06, np.zeros(400)])
    at = np.arange(40, 360)
    late = np.roll(path, 8, axis=0)
    np.testing.assert_allclose(contour_error(path, late, at), 0.0, atol=1e-12)
    np.testing.assert_allclose(contour_error(path, late + np.array([0, 0.01]), at), 0.01)


def test_overshoot_beyond_the_end_of_a_line_counts() -> None:
    path = np.column_stack([np.minimum(np.arange(200) * 0.05, 5.0), np.zeros(200)])
    at = np.arange(150, 170)
    actual = np.tile([5.2, 0.0], (200, 1))
    np.testing.assert_allclose(contour_error(path, actual, at), 0.2)


def test_standstill_does_not_count_and_extrusion_is_flagged(compensator: Compensator) -> None:
    """An extrusion to sample 40, a retraction to 60, a travel."""
    path = np.tile([103.9, 50.0, 0.0, 0.0], (100, 1))
    path[:40, 0], path[60:, 0] = 100.0 + 0.1 * np.arange(40), 103.9 + 0.2 * np.arange(1, 41)
    path[:40, 3], path[40:60, 3] = 0.01 * np.arange(40), 0.39 - 0.02 * np.arange(1, 21)
    path[60:, 3] = path[59, 3]
    block = Samples(0, path, np.zeros(100, np.int64), (), {"none": path[:, :2]})
    (judgement,) = judge([block], compensator.plant)
    assert judgement.chunk is block
    assert judgement.at.tolist() == [*range(1, 40), *range(60, 100)]
    assert len(judgement.contour["none"]) == len(judgement.tracking("none")) == 79
    assert judgement.at[judgement.extruding].tolist() == [*range(1, 40)]
