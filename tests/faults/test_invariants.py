"""The last looks at what is written: each of them is reached, and nothing appears."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hframe_post.arrays import Z
from hframe_post.conversion import pipeline
from hframe_post.conversion.options import Options
from hframe_post.conversion.whole_file import Target, WholeFile, convert
from hframe_post.errors import HframeError
from hframe_post.printer.profile import load
from hframe_post.stream.marks import Marks
from hframe_post.stream.types import Event, Samples, frozen
from hframe_post.writers import decimation, machine
from hframe_post.writers.outputs import Outputs
from tests.conftest import MEASURED

PART = (
    b"G28\nG90\nM83\nG1 X140 Y100 Z0.2 F9000\nG1 X200 Y100 E2\nM106 S9\nG1 X260 E2\n"
    b"G1 Y120 E0.7\nM106 S8\nG1 X140 E4\n"
)
LINES = PART.splitlines(keepends=True)
PAPER = load(str(MEASURED))
PRINTER = replace(PAPER, travel=replace(PAPER.travel, z=(0.0, 250.0)))
MOVING = 500  # samples; the others stand
Fault = Callable[[Samples], Samples]


def command(chunk: Samples, change: Callable[[np.ndarray], None]) -> Samples:
    """A chunk in which something happened to the command."""
    xy = chunk.commands["racking"].copy()
    change(xy)
    return replace(chunk, commands={**chunk.commands, "racking": frozen(xy)})


def path(chunk: Samples, column: int, value: float) -> Samples:
    xyze = chunk.xyze.copy()
    xyze[len(xyze) // 2, column] = value
    return replace(chunk, xyze=frozen(xyze))


def spoilt(xy: np.ndarray, value: float, samples: int = 1) -> None:
    xy[len(xy) // 2 : len(xy) // 2 + samples, 0] = value


def early(event: Event, index: int) -> Event:
    by = index - event.index
    return event.shifted(by) if isinstance(event, Marks) else replace(event, index=index)


STREAM: dict[str, tuple[Fault, str]] = {
    "a command that is not a number": (
        lambda c: command(c, lambda xy: spoilt(xy, np.nan)), "line [78]: .*is not a number"),
    "endless filament": (lambda c: path(c, 3, np.inf), "is not a number"),
    "time that is repeated": (lambda c: replace(c, first=c.first - 3), "goes back in time"),
    "time that is left out": (lambda c: replace(c, first=c.first + 3), "goes back in time"),
    "lines in another order": (
        lambda c: replace(c, events=c.events[::-1]), "goes back in time"),
    "a line before its time": (
        lambda c: replace(c, events=(early(c.events[0], c.first - 5), *c.events[1:])),
        "goes back in time"),
    "a place off the bed": (lambda c: command(c, lambda xy: spoilt(xy, 999.0)), r"x \(mm\)"),
    "a height off the bed": (lambda c: path(c, Z, -0.1), r"z \(mm\) would be -0\.1"),
    "a leap": (lambda c: command(c, lambda xy: spoilt(xy, 100.0)), "belt velocity"),
    "a jolt": (
        lambda c: command(c, lambda xy: spoilt(xy, float(xy[len(xy) // 2, 0]) + 0.2)),
        "belt acceleration"),
}  # fmt: skip


def nothing_appears(folder: Path, cause: str) -> None:
    out = folder / "out.gcode"
    out.write_bytes(b"as it was")
    with pytest.raises(HframeError, match=cause), Outputs() as outputs:
        convert(iter(LINES), Target(outputs, out), PRINTER, Options("racking", clamp=False))
    assert out.read_bytes() == b"as it was"
    assert [path.name for path in folder.iterdir()] == ["out.gcode"]


@pytest.mark.parametrize(("fault", "cause"), STREAM.values(), ids=STREAM)
def test_a_stream_that_is_not_sound(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fault: Fault, cause: str
) -> None:
    """What the stages before it would have to get wrong happens just before the guard."""

    def faulty(chunks: Iterator[Samples], *rest: Any) -> Iterator[Samples]:
        for chunk in chunks:
            yield fault(chunk) if len(chunk) > MOVING else chunk

    monkeypatch.setattr(pipeline, "check_deviation", faulty)
    nothing_appears(tmp_path, cause)


@pytest.mark.parametrize(
    ("first", "last", "cause"),
    [(0.1, 0.8, "on the wrong side of 'M106 S"), (0.9, 1.0, "mm of filament would be lost")],
)
def test_filament_that_is_not_where_it_was(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, first: float, last: float, cause: str
) -> None:
    """Segments that have lost some of it on their way into the text."""
    right = decimation.segments

    def faulty(*of: Any) -> Any:
        made = right(*of)
        at, k = made.at.copy(), len(made.at)
        at[int(first * k) : max(int(last * k), int(first * k) + 1), 3] -= 2000
        return made._replace(at=at)

    monkeypatch.setattr(machine, "segments", faulty)
    nothing_appears(tmp_path, cause)


def test_steps_and_samples_count_their_filament_too() -> None:
    commands = WholeFile(iter(LINES), PRINTER, Options("racking"))
    assert sum(len(chunk) for chunk in commands.samples())
    filament = 2.0 + 2.0 + 0.7 + 4.0
    commands.check_filament(filament)
    with pytest.raises(HframeError, match=r"0\.0020 mm of filament would be lost"):
        commands.check_filament(filament - 0.002)
