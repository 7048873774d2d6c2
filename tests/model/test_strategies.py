"""A strategy is a class and a row of the registry, from which everything else follows."""

import sys
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from hframe_post.arrays import Array
from hframe_post.model.strategies import STRATEGIES, Compensator, Strategy, strategy
from hframe_post.printer.profile import load
from tests.conftest import SAMPLES


class Late:
    """The path, some samples late: a strategy that buffers samples."""

    def __init__(self, compensator: Compensator, origin: Array) -> None:
        self._buffered = np.tile(origin, (20, 1))

    def feed(self, xy: Array) -> Array:
        known = np.concatenate([self._buffered, xy])
        self._buffered = known[len(xy) :]
        return known[: len(xy)]

    def finish(self) -> Array:
        return np.zeros((0, 2))


@pytest.fixture
def late(monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.setitem(STRATEGIES, "late", Strategy("late", "path, late", "#00a000", Late))
    read_it = ("hframe_post.cli.", "hframe_post.conversion.options")
    for name in [name for name in sys.modules if name.startswith(read_it)]:
        monkeypatch.delitem(sys.modules, name)  # imported again, with this row
    return "late"


def test_a_row_is_all_that_profiles_and_the_command_line_need(late: str, tmp_path: Path) -> None:
    out, summary = tmp_path / "out.gcode", tmp_path / "summary.json"
    part = str(SAMPLES / "rectangle.gcode")
    main = import_module("hframe_post.cli.main").main
    done = CliRunner().invoke(main, [part, "-c", late, "-o", str(out), "--json", str(summary)])
    assert done.exit_code == 0, done.output
    assert "result           path, late " in done.output
    assert out.read_bytes() != b""
    studied = CliRunner().invoke(main, ["simulate"])
    assert "path, late" in studied.output
    shown = CliRunner().invoke(main, ["convert", "--help"], terminal_width=200)
    assert "-c, --compensation [none|fbs|racking|late]" in " ".join(shown.output.split())


@pytest.mark.parametrize("name", STRATEGIES)
def test_a_strategy_never_returns_more_than_it_took_and_all_in_the_end(name: str) -> None:
    printer = load("paper")
    state = strategy(name).begin(
        Compensator(printer.plant, printer.compensation.windows), np.array([100.0, 50.0])
    )
    path = np.tile([100.0, 50.0], (150_000, 1))
    taken = returned = 0
    for piece in np.array_split(path, [1, 2, 500, 60_000, 60_001]):
        taken += len(piece)
        returned += len(state.feed(piece))
        assert returned <= taken
    assert returned + len(state.finish()) == taken
