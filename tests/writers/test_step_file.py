"""Step files: their text, and that the plant which they drive prints what was predicted."""

import gzip
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hframe_post.arrays import Array
from hframe_post.prediction.predict import judge
from hframe_post.printer.settings import Printer
from hframe_post.stream.types import Samples
from hframe_post.writers.outputs import compressing
from hframe_post.writers.tables import (
    End,
    Header,
    Item,
    Note,
    Start,
    StepFileWriter,
    Stepped,
    inlined,
)
from tests.conftest import SAMPLES
from tests.step_tools import read_steps, write_steps

MATRIX = np.array([[1.0, 1.0], [1.0, -1.0]])
HEADER = Header("1.2", "mine, too", "abc", 40_000.0, (0.02, 0.02, 0.0025, 0.0024), MATRIX)
RECTANGLE = (SAMPLES / "rectangle.gcode").read_bytes().splitlines(keepends=True)


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


def test_packing_is_the_same_every_time_and_for_others_to_unpack(tmp_path: Path) -> None:
    good = b"".join(RECTANGLE) * 10
    files = [tmp_path / f"{name}.gz" for name in "ab"]
    for path in files:
        with path.open("wb") as file, compressing(file, ".gz") as packed:
            packed.write(good[:1000])
            packed.write(good[1000:])
    assert files[0].read_bytes() == files[1].read_bytes()
    assert gzip.decompress((tmp_path / "a.gz").read_bytes()) == good


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
