"""The flow that follows the extruder late."""

import numpy as np

from hframe_post.arrays import TS, Array, E, X
from hframe_post.prediction.error_meter import Melt

K = 0.05


def line(speed: Array) -> Array:
    """Return a path along x (n + 1, 4) at these speeds, mm/s."""
    path = np.zeros((len(speed) + 1, 4))
    path[1:, X] = np.cumsum(speed * TS)
    path[:, E] = 0.03 * path[:, X]
    return path


def advance(ahead: Array) -> Array:
    return np.column_stack([ahead, np.full(len(ahead), K)])


def test_flow_comes_and_goes_with_the_time_of_the_hot_end() -> None:
    path = line(np.full(400, 100.0))
    flow = Melt().laid(path, advance(np.zeros(400))) / TS
    t = TS * np.arange(1, 401)
    np.testing.assert_allclose(flow, 3.0 * (1.0 - np.exp(-t / K)), atol=1e-9)


def test_exact_advance_makes_the_flow_right() -> None:
    speed = 60.0 + 40.0 * np.sin(np.arange(600) * 0.01)
    path = line(speed)
    fed = np.diff(path[:, E])
    flow = Melt().laid(path, advance(K * fed / TS))
    np.testing.assert_allclose(flow, fed, rtol=0.011)  # half a sample late
    plain = Melt().laid(path, advance(np.zeros(600)))
    assert np.abs(plain / fed - 1.0)[200:].max() > 0.1


def test_chunks_and_changes_of_the_advance_lose_nothing() -> None:
    path = line(np.full(300, 80.0))
    ahead = np.linspace(0.0, 0.2, 300)
    table = advance(ahead)
    table[100:, 1] = 0.08
    whole = Melt().laid(path, table)
    one = Melt()
    parts = [one.laid(path[k : k + 8], table[k : k + 7]) for k in range(0, 300 - 7, 7)]
    joined = np.concatenate(parts)
    np.testing.assert_allclose(joined, whole[: len(joined)], rtol=1e-9)


def test_what_is_held_comes_out_and_retractions_take_nothing_away() -> None:
    path = line(np.append(np.full(300, 80.0), np.zeros(1000)))
    path[500:800, E] -= 2.0  # retracted and back
    laid = Melt().laid(path, advance(np.zeros(1300)))
    assert abs(laid.sum() - path[-1, E]) < 1e-6
    assert laid[300] > 0.04 * TS
