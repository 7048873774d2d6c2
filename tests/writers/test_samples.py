"""Tables of samples: what they say, and that every kind of file says the same."""

import tracemalloc
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from hframe_post.arrays import Array
from hframe_post.prediction.predict import predict
from hframe_post.printer.settings import Printer
from hframe_post.stream.types import Samples
from hframe_post.writers.tables import COLUMNS, tabulate, write_npz
from tests.plants import Filter


@pytest.fixture(scope="module")
def table(paper: Printer, commands: Callable[[str], Samples]) -> Array:
    return np.concatenate(list(tabulate([commands("racking")], "racking", paper.plant)))


def column(table: Array, name: str) -> Array:
    return table[:, COLUMNS.index(name)]


def test_each_row(paper: Printer, commands: Callable[[str], Samples], table: Array) -> None:
    whole = commands("racking")
    ((_, motion),) = predict([whole], paper.plant)
    np.testing.assert_allclose(column(table, "t"), np.arange(1, len(whole) + 1) / 1000)
    for k, name in enumerate(("x_d", "y_d", "z", "e")):
        np.testing.assert_array_equal(column(table, name), whole.xyze[:, k])
    for k, name in enumerate(("x", "y")):
        np.testing.assert_array_equal(column(table, f"{name}_dm"), whole.commands["racking"][:, k])
        np.testing.assert_allclose(column(table, name), motion["racking"][:, k], atol=1e-9)


def test_theta_is_what_moves_the_nozzle_at_a_lever(paper: Printer, table: Array) -> None:
    """y = Gyy y_dm + (x − x_c) θ: without θ only Gyy is left."""
    y_dm = column(table, "y_dm")
    straight = Filter(paper.plant.Gyy).run(y_dm - y_dm[0]) + y_dm[0]
    lever = column(table, "x") - paper.plant.x_c
    assert np.abs(column(table, "theta")).max() > 1e-4
    np.testing.assert_allclose(
        column(table, "y"), straight + lever * column(table, "theta"), atol=1e-8
    )


@pytest.mark.parametrize("size", [1, 7, 100, 10_000])
def test_bits_do_not_depend_on_how_the_stream_is_cut(
    paper: Printer, commands: Callable[[str], Samples], table: Array, size: int
) -> None:
    whole = commands("racking")
    pieces = [
        Samples(
            whole.first + k, whole.xyze[k : k + size], whole.line[k : k + size], (),
            {"racking": whole.commands["racking"][k : k + size]},
        )
        for k in range(0, len(whole), size)
    ]  # fmt: skip
    cut = np.concatenate(list(tabulate(pieces, "racking", paper.plant)))
    np.testing.assert_array_equal(cut, table)


# ---------------------------------------------------------------------- files


def pieces(table: Array) -> Iterator[Array]:
    yield from np.array_split(table, 7)


def test_npz_is_what_numpy_would_load(tmp_path: Path, table: Array) -> None:
    for name in "ab":
        with (tmp_path / f"{name}.npz").open("wb") as file:
            write_npz(file, pieces(table), COLUMNS, "made by a test", tmp_path)
    loaded = np.load(tmp_path / "a.npz")
    assert loaded.files == [*COLUMNS, "stamp"]
    assert str(loaded["stamp"]) == "made by a test"
    for k, name in enumerate(COLUMNS):
        np.testing.assert_array_equal(loaded[name], table[:, k])
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()
    assert zipfile.ZipFile(tmp_path / "a.npz").testzip() is None
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.npz", "b.npz"]


def test_npz_does_not_hold_its_table_in_memory(tmp_path: Path) -> None:
    def long() -> Iterator[Array]:
        for _ in range(200):
            yield np.zeros((1000, len(COLUMNS)))

    tracemalloc.start()
    with (tmp_path / "a.npz").open("wb") as file:
        write_npz(file, long(), COLUMNS, "", tmp_path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert (tmp_path / "a.npz").stat().st_size > 3 * peak
