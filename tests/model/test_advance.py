"""Pressure advance: what it is in a steady line, at its ends, and within which limits."""

import numpy as np
import pytest

from hframe_post.arrays import TS, Array, E, X
from hframe_post.model.pressure_advance import NEAR, REACH, bounded, extruding, smoothed
from tests.quantities import below

HALF, VELOCITY, ACCELERATION = 10, 40.0, 2000.0
LINE = 4  # ms, about as long as a line of G-code
AROUND = REACH + NEAR + HALF


def lines(seed: int, count: int = 6) -> Array:
    """Return a path (n, 4) of lines whose speed changes at once, between travel and retractions."""
    rng, speed, flow = np.random.default_rng(seed), list[Array](), list[Array]()
    for _ in range(count):
        for _ in range(rng.integers(1, 5)):
            n = int(rng.integers(1, 300))
            speed.append(np.full(n, rng.uniform(0.0, 300.0)))
            flow.append(np.full(n, rng.uniform(0.01, 0.08)))
        gap = int(rng.integers(1, 60))
        speed += [np.full(gap, rng.choice([0.0, 120.0])), np.zeros(20)]
        flow += [np.zeros(gap), np.zeros(20)]
    v, per_mm = np.concatenate(speed), np.concatenate(flow)
    path = np.zeros((len(v) + 1, 4))
    path[1:, X], path[1:, E] = np.cumsum(v * TS), np.cumsum(v * per_mm * TS)
    path[:, E] -= np.cumsum(np.append(False, v == 0.0)) * 0.01  # retracted while it stands
    return np.vstack([np.repeat(path[:1], AROUND, axis=0), path])


def ours(path: Array, K: float = 0.05) -> Array:
    seconds = np.full(len(path), K)
    return bounded(path, seconds, VELOCITY, ACCELERATION, HALF)


@pytest.mark.parametrize("seed", range(8))
def test_the_extruder_stays_within_its_limits(seed: int) -> None:
    path = lines(seed)
    A = ours(path)
    inside = extruding(path)
    assert (A >= 0.0).all()
    fed = np.where(inside, np.diff(path[:, E]), 0.0) / TS
    added = np.diff(A) / TS
    below(np.abs(fed + added).max(), 1.1 * max(VELOCITY, fed.max()), "speed, mm/s")
    of_lines = np.diff(A[::LINE]) / (LINE * TS)
    sudden = np.abs(np.diff(of_lines)).max() / (LINE * TS)
    below(sudden, ACCELERATION, "acceleration of what is added, mm/s²")


@pytest.mark.parametrize("seed", range(4))
def test_no_filament_is_moved_out_of_a_line(seed: int) -> None:
    """It is exactly 0 at both ends of each, in travel and in retractions."""
    path = lines(seed)
    steps = extruding(path)
    outside = ~(np.append(False, steps) & np.append(steps, False))
    A = ours(path)
    assert A.max() > 0.1
    assert not A[outside].any()


def test_klippers_rule_is_a_mean_of_place_and_speed() -> None:
    """With weights that fall in both directions, of filament that retractions do not move."""
    path = lines(5)
    fed = np.where(extruding(path), np.diff(path[:, E]), 0.0)
    filament, speed = np.append(0.0, np.cumsum(fed)), np.append(0.0, fed) / TS
    half, K = 20, 0.07
    weight = 21.0 - np.abs(np.arange(-half, half + 1.0))
    mean = np.convolve(filament + K * speed, weight / weight.sum(), "valid")
    found = smoothed(path, np.full(len(path), K), half)[half:-half]
    np.testing.assert_allclose(found, mean - filament[half:-half], atol=1e-9)
