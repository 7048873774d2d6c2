"""Plain moves read many at once give the same items and errors as read one by one."""

import dataclasses
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hframe_post.errors import HframeError
from hframe_post.firmware.dialect import Advance
from hframe_post.firmware.registry import FIRMWARES
from hframe_post.gcode import batching
from hframe_post.gcode.reader import read
from hframe_post.gcode.state import ReadOptions
from hframe_post.printer.settings import Printer
from hframe_post.stream.marks import SETS, Marks
from hframe_post.stream.types import MoveAtRest, Moves, said
from tests.conftest import ROOT, SAMPLES, few
from tests.gcode_tools import one_by_one

START = [b"G28\n", b"G1 X10 Y10 Z0.2 F3000\n", b"M82\n"]
PLACES = ["0", "1", "-0", "10.", ".5", "+3", "199.999", "250", "-1", "100.12345678901", "7" * 16,
          "1e3", "--1", "1.2.3", "", "-", ".", "100000.5", "1234567", "0012.50"]  # fmt: skip
number = st.one_of(
    st.sampled_from(PLACES), st.decimals(0, 200, places=3).map(str), st.integers(0, 200).map(str)
)
words = st.lists(st.tuples(st.sampled_from("FXYZEXYEXYxIS"), number), max_size=5)
endings = st.sampled_from(
    ["", "", "", "", " ", "\t", "\r", " ; fan", ";a\rb", " ;\r", "*12", "  x"]
)
move = st.builds(
    lambda code, given, tail: f"{code}{''.join(f' {a}{n}' for a, n in given)}{tail}",
    st.sampled_from(["G1", "G1", "G1", "G0", "G01", "g1", " G1", "G1 "]), words, endings,
)  # fmt: skip
ordered = st.builds(
    lambda f, x, y, z, e: "G1" + "".join(
        f" {a}{n}" for a, n in zip("FXYZE", (f, x, y, z, e), strict=True) if n is not None
    ),
    st.none() | st.sampled_from(["0", "0.5", "1500", "60", "9000.5"]),
    *(st.none() | number for _ in range(4)),
)  # fmt: skip
other = st.sampled_from([
    "; a", "", "M83", "M82", "G91", "G90", "G20", "G21", "M220 S50", "G92 E0", "G92 X5",
    "G92 E-1.5", "M204 S500", "M204 P700", "M204 S0.5", "M106 S3", "M73 P1 R5", "M73 P1 R9",
    "M73 Q2 S4",
    "M117 7 remaining", ";TYPE:Skin", " ;LAYER:3", "  ", "M486 S1", ";printing object a",
    "SET_FAN_SPEED FAN=a", "M900 K0.1", "(x) M106", "SET_VELOCITY_LIMIT ACCEL=900",
    "SET_VELOCITY_LIMIT ACCEL=900 VELOCITY=50", "G28", "MACRO", "G2 X20 Y20 I5 J5",
    "SET_VELOCITY_LIMIT ACCEL=800 ACCEL_TO_DECEL=400 ; a", "SET_VELOCITY_LIMIT",
    "SET_VELOCITY_LIMIT ACCEL=800 SQUARE_CORNER_VELOCITY=7", "SET_VELOCITY_LIMIT  ACCEL=800 A=1",
    "SET_VELOCITY_LIMIT SQUARE_CORNER_VELOCITY=0 ACCEL_TO_DECEL=0", "SET_VELOCITY_LIMIT ACCEL=0",
    "SET_VELOCITY_LIMIT MINIMUM_CRUISE_RATIO=0", "M205 X8 Y12", "M205 X-1", "M205 E5 Z1",
    "M205 J0.02", "M205 S0 T0 X3 X5", "M204 S500 S600", "M204 P500 R1000 T700", "M204 T2000",
    "M204 S600 ; b", "M204", "M205 X", "SET_PRESSURE_ADVANCE ADVANCE=0.04",
    "SET_PRESSURE_ADVANCE SMOOTH_TIME=0.03",
    "SET_PRESSURE_ADVANCE EXTRUDER=b ADVANCE=1", "M900 K0.05 T1", "M900 L3", "M201 E100", "M203 Z5",
    "G17", "G18", "G90 ; a", "M83 X", "SET_VELOCITY_LIMIT VELOCITY=60 MINIMUM_CRUISE_RATIO=0.3",
    "SET_VELOCITY_LIMIT MINIMUM_CRUISE_RATIO=-1", "SET_VELOCITY_LIMIT VELOCITY=0.05",
    "; time left: 5s", "M117 time left 5m", ";TIME_ELAPSED:5.", ";TIME_ELAPSED:5.5",
])  # fmt: skip


def items(lines: list[bytes], options: ReadOptions) -> list[Any]:
    """Return all items and errors of the reader in a form that can be compared."""
    read_items: list[Any] = []
    try:
        for item in read(iter(lines), options):
            names = () if isinstance(item, Marks) else dataclasses.fields(item)
            values: list[Any] = [getattr(item, each.name) for each in names] or [item]
            values = [list(v) if isinstance(v, Marks) else v for v in values]
            values = [v.tobytes() if isinstance(v, np.ndarray) else repr(v) for v in values]
            read_items.append((type(item).__name__, *values))
    except HframeError as error:
        read_items.append(str(error))
    return read_items


@pytest.mark.slow
@settings(max_examples=100, deadline=None,
          suppress_health_check=[HealthCheck.function_scoped_fixture])  # fmt: skip
@given(
    st.lists(st.one_of(ordered, ordered, ordered, ordered, move, other), max_size=30),
    st.sampled_from(sorted(FIRMWARES)), st.sampled_from(["\n", "\r\n", ""]), st.booleans(),
)  # fmt: skip
def test_any_lines(paper: Printer, texts: list[str], firmware: str, end: str, bed: bool) -> None:
    options = ReadOptions(FIRMWARES[firmware].dialect, travel=paper.travel if bed else None)
    lines = START + [(text + end).encode() for text in texts]
    same_either_way(lines, options)


object_name = st.sampled_from(["a", "A", "b_c", "b c", "-1", ""])
label = st.builds(
    lambda form, name: form.format(name),
    st.sampled_from([
        "EXCLUDE_OBJECT_START NAME={}", "EXCLUDE_OBJECT_END NAME={}", "EXCLUDE_OBJECT_END",
        "; printing object {} id:0", "; stop printing object {}", ";MESH:{}", ";PRINTING_ID: {}",
        "M486 S1", "M486 S-1", "M486 S{}", "M486 T2", " ;MESH:{} TYPE:", "exclude_object_end",
        "EXCLUDE_OBJECT_START NAME={}\0", ";TIME_ELAPSED:{}",
    ]), object_name,
)  # fmt: skip
setting = st.builds(
    lambda name, word: f"{name} {word}", st.sampled_from(["SET_PRESSURE_ADVANCE", "M900"]),
    st.sampled_from(["ADVANCE=0.04", "ADVANCE=0.05", "SMOOTH_TIME=0.03", "K0.1", "K0.2", "T1 K9"]),
)  # fmt: skip
mode = st.sampled_from(["G90", "G91", "M82", "M83", "G17", "G18", "G21", "g90", "M83 ; a"])
going = st.one_of(
    st.integers(20, 60).map("G1 X{}".format), st.integers(20, 60).map("G1 X{} Y9 E1".format),
    st.sampled_from(["G1 Z.6", "G1 E-1", "G92 E0", "G20", "MACRO"]),
)  # fmt: skip


@settings(max_examples=100, deadline=None)
@given(
    st.lists(st.one_of(label, label, going, setting, mode), max_size=20), st.integers(1, 3),
    st.sampled_from(sorted(FIRMWARES)),
)  # fmt: skip
def test_lines_that_recur(texts: list[str], times: int, firmware: str) -> None:
    """What was read once is known: labels of objects, and lines that set what is set."""
    options = ReadOptions(FIRMWARES[firmware].dialect)
    lines = START + [text.encode() + b"\n" for text in texts] * times
    same_either_way(lines, options)


def test_more_objects_than_the_loop_can_know() -> None:
    lines = START + [
        line
        for k in (*range(300), *range(500))
        for line in (b"; printing object %d\n" % (k % 70 if k < 300 else k), b"G1 X%d\n" % (k % 7))
    ]
    same_either_way(lines, ReadOptions(FIRMWARES["klipper"].dialect))


@pytest.mark.parametrize("name", few(["cube.gcode", "prism.gcode"], 1))
def test_a_slice(name: str) -> None:
    lines = (SAMPLES / name).read_bytes().splitlines(keepends=True)
    same_either_way(lines, ReadOptions(FIRMWARES["klipper"].dialect))


@pytest.mark.parametrize("path", sorted((ROOT / "tests" / "quirks").glob("*.gcode")), ids=str)
def test_quirks(path: Any) -> None:
    lines = path.read_bytes().splitlines(keepends=True)
    for firmware in FIRMWARES.values():
        same_either_way(lines, ReadOptions(firmware.dialect))


def test_an_error_of_the_source_comes_in_its_turn() -> None:
    """The lines before it are read, and their errors come first."""

    def source(wrong: bytes) -> Any:
        yield from START
        yield wrong
        raise OSError("gone")

    with pytest.raises(OSError, match="gone"):
        list(read(source(b"G1 X20\n"), ReadOptions(FIRMWARES["klipper"].dialect)))
    with pytest.raises(HframeError, match="F"):
        list(read(source(b"G1 X20 F-3\n"), ReadOptions(FIRMWARES["klipper"].dialect)))


def advances(lines: list[bytes], options: ReadOptions) -> list[tuple[tuple[int, int], Advance]]:
    """Return the pressure advance that later stages find after each item's lines that set it."""
    advance, found = (
        Advance(0.0, 0.0, options.dialect.advance),
        list[tuple[tuple[int, int], Advance]](),
    )
    try:
        for k, item in enumerate(read(iter(lines), options)):
            marks = item.marks if isinstance(item, Moves) else item
            for mark in said(marks, SETS) if not isinstance(marks, MoveAtRest) else ():
                advance = advance.after(mark.text)
                at = (k, mark.index)
                if found and found[-1][0] == at:
                    found.pop()
                if not found or found[-1][1] != advance:
                    found.append((at, advance))
    except HframeError:
        pass
    return found


def same_either_way(lines: list[bytes], options: ReadOptions) -> None:
    together = items(lines, options), advances(lines, options)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(batching, "plain_lines", one_by_one)
        assert (items(lines, options), advances(lines, options)) == together
