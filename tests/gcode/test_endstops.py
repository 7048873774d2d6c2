"""Marlin's soft endstops end moves of homed axes at the edge, where the profile knows them."""

from dataclasses import replace

import pytest

from hframe_post.errors import LimitError
from hframe_post.firmware.registry import Marlin
from hframe_post.gcode.reader import read
from hframe_post.gcode.state import ReadOptions
from hframe_post.printer.settings import Travel
from hframe_post.stream.types import MoveAtRest, Moves

EDGES = ((-5.0, 220.0), (0.0, 210.0), (0.0, 200.0))
DIALECT = replace(Marlin.dialect, soft_endstops=EDGES)
HOME = ["G28", "G90", "M83", "G1 X10 Y10 Z.2 F6000"]


def ends(lines: list[str], travel: Travel | None = None) -> tuple[list[list[float]], list[str]]:
    """Return the ends of moves, and what is noted."""
    notes: list[str] = []
    options = ReadOptions(
        DIALECT, travel=travel or Travel(*EDGES), note=lambda _, text: notes.append(text)
    )
    found: list[list[float]] = []
    for item in read([line.encode() + b"\n" for line in lines], options):
        if isinstance(item, Moves):
            found += item.points[1:].tolist()
        elif isinstance(item, MoveAtRest):
            found.append(list(item.end))
    return found, notes


@pytest.mark.parametrize(
    ("lines", "expected"),
    [
        (["G1 X20 Y230 E1"], [[20, 210, 0.2, 1]]),
        (["G1 Y230", "G91", "G1 Y-5"], [[10, 210, 0.2, 0], [10, 205, 0.2, 0]]),
        (["G1 X-9 E2"], [[-5, 10, 0.2, 2]]),
        (["G1 Y210", "G1 Y215 E1"], [[10, 210, 0.2, 0], [10, 210, 0.2, 1]]),  # only filament
        (["G1 Z-1"], [[10, 10, 0, 0]]),
        (["G92 Y100", "G1 Y310"], [[10, 210, 0.2, 0]]),  # of the machine, not of the file
        (["M211 S0", "M211 S1", "G1 Y230"], [[10, 210, 0.2, 0]]),
        (["M211", "G1 Y230"], [[10, 210, 0.2, 0]]),
    ],
)
def test_a_move_ends_at_the_edge_and_is_said(lines: list[str], expected: list[list[float]]) -> None:
    found, notes = ends([*HOME, *lines])
    assert found == [pytest.approx(place) for place in expected]
    assert notes
    assert "line " in notes[0]


def test_chords_of_an_arc_end_there_too() -> None:
    found, notes = ends([*HOME, "G1 X100 Y200", "G2 X130 Y200 I15 J0 E3"])
    ys = [y for _, y, *_ in found]
    assert max(ys) == 210.0
    assert ys[-1] == pytest.approx(200.0)
    assert found[-1][3] == pytest.approx(3.0)
    assert notes


@pytest.mark.parametrize(
    "lines",
    [
        [*HOME, "M211 S0", "G1 Y230"],
        [*HOME[1:], "G1 Y230"],  # never homed: the firmware would leave the bed
        ["G28 X", *HOME[1:], "G1 Y230"],
    ],
)
def test_where_they_do_not_hold_it_is_an_error(lines: list[str]) -> None:
    with pytest.raises(LimitError, match=f"line {len(lines)}"):
        ends(lines)


def test_an_edge_off_the_bed_is_an_error() -> None:
    with pytest.raises(LimitError):
        ends([*HOME, "G1 Y230"], Travel((0.0, 220.0), (0.0, 205.0)))
