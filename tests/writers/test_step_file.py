"""Files of steps and of samples: what they say, and that steps drive the plant as predicted."""

import tracemalloc
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hframe_post.arrays import Array
from hframe_post.model.plant import nozzle
from hframe_post.prediction.predict import judge
from hframe_post.printer.settings import Printer
from hframe_post.stream.types import Samples
from hframe_post.writers.tables import (
    COLUMNS,
    DECIMALS,
    End,
    Header,
    Item,
    Note,
    Start,
    StepFileWriter,
    Stepped,
    as_csv,
    inlined,
    tabulate,
    write_npz,
)
from tests.gcode_tools import sample
from tests.plants import Filter
from tests.step_tools import read_steps, write_steps

MATRIX = np.array([[1.0, 1.0], [1.0, -1.0]])
HEADER = Header("1.2", "mine, too", "abc", 40_000.0, (0.02, 0.02, 0.0025, 0.0024), MATRIX)
RECTANGLE = sample("rectangle.gcode")


def test_inline_events_stand_after_the_steps_of_their_tick() -> None:
    keys = np.array([5 * 8, 5 * 8 + 2, 6 * 8])
    notes = (Note(0, "carried", b"a,b"), Note(5, "rest", b"G4 P1"))
    writer = StepFileWriter(HEADER)
    items: list[Item] = [Start(0, (0, 0, 0, 0)), Stepped(keys, notes), End(6)]
    lines = b"".join(inlined(writer.write(items))).splitlines()
    assert lines[-6:] == [
        b"#event,0,carried,a,b", b"5,A,0", b"5,B,0", b"#event,5,rest,G4 P1", b"6,A,0", b"#end,6,3",
    ]  # fmt: skip
    assert (writer.rows, writer.lines) == (3, len(lines) - len(notes))


def at_milliseconds(path: Path, printer: Printer, samples: int) -> Array:
    """x and y at the end of every millisecond, as the motors hold them between their steps."""
    assert printer.steps is not None
    tick, xyze = read_steps(path.read_bytes(), printer)
    now = np.arange(1, samples + 1) * printer.steps.clock_hz / 1000.0
    return xyze[np.searchsorted(tick, now, side="right") - 1, :2]


@pytest.mark.parametrize("strategy", ["racking", "none"])
def test_plant_driven_by_the_steps_prints_what_was_predicted(
    tmp_path: Path, paper: Printer, commands: Callable[[str], Samples], strategy: str
) -> None:
    """G-code → CSV → positions → plant → contour error, compared with the samples'."""
    report = write_steps(tmp_path / "r.csv", RECTANGLE, paper, strategy)
    whole = commands(strategy)
    stepped = at_milliseconds(tmp_path / "r.csv", paper, len(whole))
    exact = whole.commands[strategy]
    half = np.abs((stepped - exact) @ MATRIX.T).max()
    fastest = np.abs(np.diff(exact @ MATRIX.T, axis=0)).max() / 40
    assert half <= 0.0206 / 2 + fastest + 1e-3
    both = {"samples": exact, "steps": stepped}
    played = replace(whole, commands=both)
    (judged,) = judge([played], paper.plant)
    rms = {name: float(np.sqrt((e**2).mean())) for name, e in judged.contour.items()}
    rounding = 0.0206 / np.sqrt(12.0)  # of x and y together: (A ± B)/2, each step/√12
    assert 0.95 * rms["samples"] <= rms["steps"] <= 1.001 * np.hypot(rms["samples"], rounding)
    assert report.steps is not None
    assert report.steps.rows > 20_000


@pytest.fixture(scope="module")
def table(paper: Printer, commands: Callable[[str], Samples]) -> Array:
    return np.concatenate(list(tabulate([commands("racking")], "racking", paper.plant)))


def column(table: Array, name: str) -> Array:
    return table[:, COLUMNS.index(name)]


def test_each_row(paper: Printer, commands: Callable[[str], Samples], table: Array) -> None:
    whole = commands("racking")
    command = whole.commands["racking"]
    moved = nozzle(paper.plant, command[0], command)
    np.testing.assert_allclose(column(table, "t"), np.arange(1, len(whole) + 1) / 1000)
    for k, name in enumerate(("x_d", "y_d", "z", "e")):
        np.testing.assert_array_equal(column(table, name), whole.xyze[:, k])
    for k, name in enumerate(("x", "y")):
        np.testing.assert_array_equal(column(table, f"{name}_dm"), command[:, k])
        np.testing.assert_allclose(column(table, name), moved[:, k], atol=1e-9)
    names, *rows = b"".join(as_csv([table])).splitlines()
    assert names == ",".join(COLUMNS).encode()
    off = np.abs(np.loadtxt(rows, delimiter=",") - table)
    assert (off <= 0.51 * 10.0 ** -np.array(DECIMALS)).all()


def test_theta_is_what_moves_the_nozzle_at_a_lever(paper: Printer, table: Array) -> None:
    """y = Gyy y_dm + (x − x_c) θ: without θ only Gyy is left."""
    y_dm = column(table, "y_dm")
    straight = Filter(paper.plant.Gyy).run(y_dm - y_dm[0]) + y_dm[0]
    lever = column(table, "x") - paper.plant.x_c
    assert np.abs(column(table, "theta")).max() > 1e-4
    np.testing.assert_allclose(
        column(table, "y"), straight + lever * column(table, "theta"), atol=1e-8
    )


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
