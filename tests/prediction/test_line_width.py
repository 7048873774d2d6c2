"""The width of the printed line, from the nozzle's way and from the flow that follows late."""

import numpy as np
import pytest

from hframe_post.arrays import TS, Array, E, X, Y, Z
from hframe_post.conversion.options import Options
from hframe_post.conversion.whole_file import WholeFile
from hframe_post.native.judging import line_pieces
from hframe_post.prediction.error_meter import PIECE_MM, Melt
from hframe_post.printer.settings import Printer
from hframe_post.studies.tuning import rectangle


def drawn(path: Array, nozzle: Array) -> Array:
    """Return |w − 1| of a line's pieces that are complete."""
    return line_pieces(path, nozzle, fed(path), PIECE_MM, np.zeros(4))[1]


def fed(path: Array) -> Array:
    """Return the filament that comes out in the step to each sample, (n,), without pressure."""
    return np.diff(path[:, E], prepend=path[0, E])


def straight(n: int = 500, step: float = 0.05, flow: float = 0.03) -> Array:
    """Return a line along x, (n, 4)."""
    path = np.zeros((n, 4))
    path[:, X] = step * np.arange(n)
    path[:, E] = flow * path[:, X]
    return path


def test_a_nozzle_on_the_path_draws_the_line_that_was_sliced() -> None:
    path = straight()
    path[200:, Y] = 0.05 * np.arange(300)  # a bend
    path[:, E] = np.cumsum(np.hypot(*np.diff(path[:, :Z], axis=0, prepend=path[:1, :Z]).T) * 0.03)
    assert len(drawn(path, path[:, :Z])) > 60
    assert drawn(path, path[:, :Z]).max() < 1e-9
    np.testing.assert_array_less(drawn(path, path[:, :Z] + [5.0, 7.0]), 1e-9)  # wherever it is


@pytest.mark.parametrize("flow", [0.001, 0.03, 0.3])
def test_more_way_makes_a_thinner_line_whatever_the_flow(flow: float) -> None:
    path = straight(flow=flow)
    np.testing.assert_allclose(drawn(path, 1.25 * path[:, :Z]), 0.2)  # 1/1.25 − 1
    np.testing.assert_allclose(drawn(path, 0.8 * path[:, :Z]), 0.25)


def test_only_lines_count() -> None:
    """Travel, retractions and standstill end a line; a rest of less than half a piece is left."""
    path = straight(100)
    path[40:60, E] = path[40, E]  # travel
    path[60:, E] -= path[60, E] - path[40, E]
    path[80:, E] -= 0.5  # a retraction in motion
    nozzle = path[:, :Z].copy()
    nozzle[40:60, X] += np.linspace(0.0, 3.0, 20)  # wherever the nozzle is in travel
    nozzle[60:, X] += 3.0
    errors = drawn(path, nozzle)
    assert len(errors) == 5 + 2 + 2  # of 1.95, 0.95 and 0.95 mm; the last piece is still open
    assert errors.max() < 1e-9


def test_where_a_piece_ends_does_not_depend_on_chunks() -> None:
    rng = np.random.default_rng(0)
    path = straight(3000)
    path[:, E] += np.cumsum(rng.normal(0.0, 0.002, 3000))  # sometimes back
    nozzle = path[:, :Z] + np.cumsum(rng.normal(0.0, 0.01, (3000, 2)), axis=0)
    whole = drawn(path, nozzle)
    begun, found = np.zeros(4), []
    for low in range(0, 2999, 7):
        part = slice(low, min(low + 7, 2999) + 1)
        _, errors, begun = line_pieces(path[part], nozzle[part], fed(path[part]), PIECE_MM, begun)
        found.append(errors)
    np.testing.assert_allclose(np.concatenate(found), whole, rtol=1e-9)


@pytest.mark.paper
def test_compensation_keeps_the_line_even(paper: Printer) -> None:
    """The rectangle on an exact model, without pressure: 22 % without compensation."""
    commands = WholeFile(rectangle(paper), paper, Options("racking", ("none", "racking")))
    assert len(list(commands.samples()))
    width = commands.report.width
    assert 0.20 < width["none"].rms < 0.24
    assert width["racking"].rms < 0.15 * width["none"].rms


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
