"""Prints of many slicers from end to end: nothing lost, in order, everything reported."""

from dataclasses import replace

import numpy as np
import pytest

from hframe_post.conversion.print_report import Report
from hframe_post.gcode.reader import CHANGE_OF_OBJECT
from hframe_post.prediction.statistics import BEFORE
from hframe_post.printer.profile import parse
from hframe_post.printer.settings import Printer
from tests import gcode_tools
from tests.conversion.slice_tools import carried, converted, filament
from tests.prediction.label_tools import block, names, printing
from tests.quantities import below
from tests.slices import LAYERS, SLICES, Slice


@pytest.mark.parametrize("each", SLICES.values(), ids=SLICES)
def test_every_slicer_converts(each: Slice, paper: Printer) -> None:
    output, deferred, report = converted(each, paper)
    source = [line.rstrip(b"\n") for line in each.lines]
    hidden = each.name == "hidden_relative"
    before, after = filament(source, hidden), filament(output, hidden)
    assert len(before) == len(after) >= LAYERS
    np.testing.assert_allclose(after, before, atol=1e-3)
    assert before[-1] > 5.0
    assert carried(output) == carried(source)
    below(report.read.extrusion_share, 0.005, "share of the extrusion that is not compensated")
    for start in each.times:
        rewritten = [d for d in deferred if d.startswith(start.encode())]
        assert rewritten or any(line.startswith(start.encode()) for line in output)
    assert all(any(d.startswith(t.encode()) for t in each.times) for d in deferred)


@pytest.mark.parametrize("each", SLICES.values(), ids=SLICES)
def test_layers_of_every_slicer_are_recognised(each: Slice) -> None:
    comments = [(k, line.rstrip(b"\n")) for k, line in enumerate(each.lines)]
    layers, features = names([block(printing(len(comments) + 1), *comments)])
    assert len(set(layers) - {BEFORE}) == LAYERS
    assert set(features) != {BEFORE} or each.name == "sailfish"


def test_uncompensated_motion_is_reported_by_its_cause(paper: Printer) -> None:
    printed = SLICES["prusaslicer"]
    known = converted(printed, paper)[2]
    unknown = converted(replace(printed, harmless=()), paper)[2]
    assert set(known.read.uncompensated) == {"START_PRINT", CHANGE_OF_OBJECT}
    assert unknown.read.uncompensated["_ON_LAYER_CHANGE"].moves == 2 * LAYERS
    shares = unknown.as_json()["uncompensated"]
    assert shares["path_percent"] > 5.0
    assert "_ON_LAYER_CHANGE" in shares["by_cause"]
    assert "_ON_LAYER_CHANGE" in unknown.as_text()


def test_macros_that_return_keep_their_place(paper: Printer) -> None:
    """They run with the user's limits in force, and everything after them is compensated."""
    lines = [
        b"M83\n", b"G92 X100 Y100 Z1 E0\n", b"G1 X120 E1 F6000\n", b"TIMELAPSE_TAKE_FRAME\n",
        b"G1 X140 E1\n",
    ]  # fmt: skip
    firmware = replace(paper.firmware, returns=("TIMELAPSE_*",))
    output, report = gcode_tools.converted(lines, replace(paper, firmware=firmware))
    text = output.splitlines()
    frame = text.index(b"TIMELAPSE_TAKE_FRAME")
    assert any(line.startswith(b"SET_VELOCITY_LIMIT VELOCITY=") for line in text[frame - 4 : frame])
    assert not report.read.uncompensated


def test_filament_that_a_lost_g92_takes_back_is_a_warning(paper: Printer) -> None:
    lines = [b"M82\n", b"G92 E0\n", b"G1 X100 Y100 Z1 F6000\n", b"G1 X150 E9.5\n"]
    for more, told in (([], True), ([b"G92 E0\n"], False)):
        report = gcode_tools.converted([*lines, *more, b"G1 X100 E.5\n"], paper)[1]
        assert any("line 5 takes back 9.0 mm" in text for text in report.warnings()) == told


def test_a_print_from_an_unknown_place_is_told_to_begin_with_a_move(paper: Printer) -> None:
    lines = [b"M83\n", b"G0 Y10 F6000\n", *[b"G1 X100 E1\n", b"G1 X120 E1\n"] * 3]
    report = gcode_tools.converted(lines[:3], paper)[1]
    assert any("begin with a move to X, Y and Z" in each for each in report.warnings())


PROFILE = 'extends = "paper"\n[plant]\ninvented = false\n[firmware]\n'
HALF = [f"G1 X{80 + 40 * (k % 2)} Y{80 + 5 * k} E{k + 1} F6000" for k in range(4)]
OTHER = [line.replace("X1", "X3") for line in HALF]  # beyond the bed of the first carriage


def with_tools(settings: str, lines: list[str]) -> tuple[str, Report]:
    """Return what a file becomes on a profile with these settings of [firmware]."""
    text = ["G90", "M82", "G1 X80 Y80 Z1 F3000", *lines]
    printer = parse(PROFILE + settings, "own")
    output, report = gcode_tools.converted([f"{line}\n".encode() for line in text], printer)
    return output.decode(), report


@pytest.mark.parametrize("tool", ["T1", "T3 ; the fourth"])
def test_a_file_that_changes_tools_gets_a_warning(tool: str) -> None:
    _, report = with_tools("", [*HALF, "G92 E0", tool, "G92 E0", *HALF])
    (warning,) = [w for w in report.warnings() if "changes tools" in w]
    assert f"changes tools ({tool[:2]}), and all are compensated with the model of" in warning
    for settings, lines in (
        ("", [*HALF, "T0"]),
        ("other_tools = []", [*HALF, tool, "G92 E0", *HALF]),
        ('harmless = ["T*"]', [*HALF, tool, "G92 E0", *HALF]),
    ):
        _, report = with_tools(settings, lines)
        assert "tool" not in "".join(report.warnings())


def test_what_another_tool_prints_is_left_to_the_firmware() -> None:
    lines = [*HALF, "T1", "G92 E0", *OTHER, "G1 Z2", *OTHER[::-1], "T0", "G92 E0", *HALF]
    text, report = with_tools('other_tools = ["T1"]', lines)
    before, _, rest = text.partition("\nT1\n")
    others, _, after = rest.partition("\nT0\n")
    assert [line for line in OTHER if line not in others] == []
    assert others.count("\nG1 X") == 2 * len(OTHER)
    assert all(part.count("\nG1 ") > 20 * len(HALF) for part in (before, after)), "lines"
    shares = report.as_json()["uncompensated"]["by_cause"]
    assert shares["T1"]["moves"] == 2 * len(OTHER) + 1
    (warning,) = [w for w in report.warnings() if "not compensated" in w]
    assert "the profile has no model of T1 (other_tools in the profile)" in warning
