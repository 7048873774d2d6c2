"""The stage that adds pressure advance: cuts, lines of the file, and filament at every stop."""

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np
import pytest

from hframe_post.arrays import Array
from hframe_post.compensation.advance import Advancing
from hframe_post.conversion.options import Options
from hframe_post.conversion.whole_file import WholeFile
from hframe_post.firmware.dialect import Advance, ExtruderLimits, klipper_advance, marlin_advance
from hframe_post.printer.profile import load
from hframe_post.printer.settings import Extruder
from hframe_post.stream.types import Samples
from tests.gcode_tools import converted, sample

LIMITS = ExtruderLimits(40.0, 2000.0)
ADVANCES = {
    "Klipper's": (Advance(0.05, 0.04, klipper_advance), None),
    "ours": (Advance(0.05, 0.04, marlin_advance), LIMITS),
}


@pytest.fixture(scope="module")
def chunks() -> list[Samples]:
    """Return part of the cube, in which the advance changes."""
    lines = sample("cube.gcode")
    lines = lines[: lines.index(b";LAYER:1\n")][:160]
    for at, text in (
        (80, b"M900 K0.09\n"), (80, b"SET_PRESSURE_ADVANCE ADVANCE=0.09 SMOOTH_TIME=0.02\n"),
        (120, b"M900 K0\n"), (120, b"SET_PRESSURE_ADVANCE ADVANCE=0\n"),
    ):  # fmt: skip
        lines.insert(at, text)
    source = WholeFile(iter(lines), load("paper"), Options("none", limits="printer"))
    return list(source.commands())


def advances(chunks: Iterable[Samples], name: str) -> tuple[Array, Advancing]:
    stage = Advancing(*ADVANCES[name])
    found: Iterator[Array] = (
        np.zeros((len(c), 2)) if c.advance is None else c.advance for c in stage.samples(chunks)
    )
    return np.concatenate(list(found)), stage


@pytest.mark.parametrize("name", ADVANCES)
def test_lines_of_the_file_change_it(chunks: list[Samples], name: str) -> None:
    found, stage = advances(chunks, name)
    assert (stage.summary.least, stage.summary.most) == (0.0, 0.09)
    seconds = found[:, 1]
    assert {*np.unique(seconds)} == {0.0, 0.05, 0.09}
    assert np.argmax(seconds == 0.09) < np.argmax(seconds == 0.0)
    assert not found[-1].any()


@pytest.mark.parametrize(("extruder", "told"), [(2000.0, True), (4000.0, False)])
def test_the_summary_tells_where_klipper_outruns_the_extruder(extruder: float, told: bool) -> None:
    paper = load("paper")
    limits = replace(paper.limits, extruder_acceleration=extruder)
    printer = replace(paper, extruder=Extruder(0.05), limits=limits)
    _, report = converted(sample("rectangle.gcode"), printer)
    assert ("more than limits.extruder_acceleration (2000)" in report.as_text()) == told
    assert 2500.0 < report.advancing.hardest < 3500.0
