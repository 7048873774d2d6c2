"""Reading: modal state, pass-through lines, and what is refused."""

import math
from itertools import pairwise

import numpy as np
import pytest

from hframe_post.errors import GcodeError
from hframe_post.firmware.registry import FIRMWARES
from hframe_post.gcode import batching
from hframe_post.gcode.reader import read
from hframe_post.gcode.state import ReadOptions
from hframe_post.printer.profile import load
from hframe_post.stream.types import Handling, Moves, Passthrough
from tests.gcode.reading import HOME, carried, ends, items, moves
from tests.gcode_tools import quirk
from tests.mark_tools import mark
from tests.printers import JERK, with_marlin

KLIPPER = FIRMWARES["klipper"].dialect


# ---------------------------------------------------------------------- modal state


def test_inches_are_of_all_words() -> None:
    found = ends("G20", "G1 X1 Y2 E1 F2", "G21", "G1 X10")
    assert found == [[25.4, 50.8, 0, 25.4], [10, 50.8, 0, 25.4]]


def test_limits_of_the_file() -> None:
    lines = ("M205 X8 Y6", "M201 X500 Y400 Z100 E5000", "M203 X300", "G1 X1")
    (block,) = moves(*lines)
    assert block.corner[0] == 6
    assert block.limits.acceleration == (500, 400, 100, 5000)
    assert block.limits.velocity == (300, math.inf, math.inf, math.inf)
    (ignoring,) = moves(*lines, "M220 S50", "G1 X2", limits="printer")
    assert math.isinf(ignoring.corner[0])
    assert math.isinf(ignoring.limits.velocity[0])
    assert ignoring.speed[1] == 50


@pytest.mark.parametrize(
    ("own", "line", "corner", "deviation"),
    [
        ({}, "M205 X8 Y6", math.inf, 0.013),
        ({}, "M205 X8 J0.02", math.inf, 0.02),
        ({}, "M205 J0", math.inf, 0.0),
        (JERK, "M205 X8 Y6 J0.02", 6.0, math.inf),
    ],
)
def test_a_board_obeys_its_own_kind_of_corners(
    own: dict[str, object], line: str, corner: float, deviation: float
) -> None:
    """Marlin is built with junction deviation (J) or with jerk (X, Y) and ignores the other."""
    printer = with_marlin(load("paper-marlin"), **own)
    lines = [f"{text}\n".encode() for text in (*HOME, line, "G1 X1")]
    (block,) = (
        item for item in read(lines, ReadOptions.from_printer(printer)) if isinstance(item, Moves)
    )
    assert (block.corner[0], block.limits.deviation) == (corner, deviation)


def test_set_velocity_limit() -> None:
    (block,) = moves(
        "SET_VELOCITY_LIMIT ACCEL=3000 SQUARE_CORNER_VELOCITY=0 VELOCITY=120 "
        "MINIMUM_CRUISE_RATIO=0.2", "G1 X1",
    )  # fmt: skip
    assert (block.acceleration[0], block.corner[0]) == (3000, 0)
    assert (block.limits.path, block.limits.cruise_ratio) == (120, 0.2)


# ---------------------------------------------------------------------- unknown places


def test_moves_from_unknown_positions_pass_through() -> None:
    found = items("G28", "G1 Z2 F3000", "G1 X10 Y20", "G1 X20 E1")
    verbatim = [i for i in found if isinstance(i, Passthrough) and i.handling is Handling.RELEASE]
    assert [i.text for i in verbatim] == [b"G28", b"G1 Z2 F3000", b"G1 X10 Y20", b""]
    (block,) = (i for i in found if isinstance(i, Moves))
    assert block.points.tolist() == [[10, 20, 2, 0], [20, 20, 2, 1]]


@pytest.mark.parametrize("line", ["G28", "T1", "M600", "PRINT_START BED=60", "G29", "M0 Click"])
def test_position_is_unknown_after_a_command_that_may_move(line: str) -> None:
    after = items(*HOME, "G1 X5", line, "G1 X7 Y7", "G1 X8")
    assert b"G1 X7 Y7" in carried(after)
    assert after[-2].points[0, 0] == 7 if isinstance(after[-2], Moves) else False


def test_pass_through_lines_have_the_modal_state_of_the_file() -> None:
    found = items(*HOME, "M82", "G92 E1.5", "G1 X5 E2 F1200", "G91", "T1")
    state = next(i for i in found if isinstance(i, Passthrough) and i.text == b"T1").state
    assert (state.absolute, state.absolute_e, state.e, state.feed) == (False, True, 2, 20)


# ---------------------------------------------------------------------- what passes


def test_lines_that_are_not_motion_pass_byte_for_byte_and_in_order() -> None:
    lines = [
        ";TYPE:FILL", "M106 S173.4", "G1 X5", "; \xe9\xff odd", "M117 Layer (2) 50%", "G1 X6",
        "M104 S200 ; warm", "SET_PRESSURE_ADVANCE ADVANCE=0.04", "", "G1 X7", "M84 X Y E", "%",
    ]  # fmt: skip
    raw = [line.encode("latin-1") for line in lines]
    found = list(read([b"G92 X0 Y0 Z0", *raw], ReadOptions(KLIPPER)))
    assert carried(found) == [b"G92 X0 Y0 Z0"] + [r for r in raw if not r.startswith(b"G1")]


def test_marks_stand_before_their_move(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(batching, "MOVES_PER_ITEM", 2)
    lines = ("G1 X1", ";a", "G1 X2", "G1 X3", ";b", "G1 X4", ";c", "G1 X5")
    blocks = moves(*lines)
    assert [block.marks for block in blocks[:2]] == [mark(1, b";a"), mark(1, b";b")]
    for one, following in pairwise(blocks):
        np.testing.assert_array_equal(one.points[-1], following.points[0])


@pytest.mark.parametrize(
    "name", ["bom", "checksums", "crlf", "lower_and_tight", "no_final_newline", "thumbnail"]
)
def test_the_same_square_in_many_spellings(name: str) -> None:
    (block,) = (item for item in read(quirk(name), ReadOptions(KLIPPER)) if isinstance(item, Moves))
    assert block.points.tolist() == [
        [10, 10, 0.2, 0], [30, 10, 0.2, 1.5], [30, 30, 0.2, 3], [10, 30, 0.2, 4.5],
        [10, 10, 0.2, 6],
    ]  # fmt: skip


# ---------------------------------------------------------------------- what is refused


@pytest.mark.parametrize(
    "line",
    [
        "G1 XNaN", "G1 X1.2.3", "G1 Xabc", "G1 X", "G1 X1 F0", "G1 X1 F-5", "G1 X1 X2",
        "G1 A5", "G1 X99999999", "G53 G1 X1", "G54", "G59", "G5.1 X1", "G92.1",
        "N3 G1 X5*9", "M204 S-1", "M204 S0", "M220 S0", "G2 X5 Y5", "G2 X50 I1 J0", "G2 X9 R1",
        "; processed by hframe-post 0.1.0",
    ],
)  # fmt: skip
def test_a_line_that_could_be_misread_is_an_error(line: str) -> None:
    with pytest.raises(GcodeError) as caught:
        items(*HOME, line)
    assert caught.value.line == len(HOME) + 1
    assert str(caught.value).startswith(f"line {len(HOME) + 1}: ")
