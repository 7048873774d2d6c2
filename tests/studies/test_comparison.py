"""Comparison of files: the same motion is the same however written, and each change is found."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

import hframe_post as hp
from hframe_post.conversion.options import TOLERANCE
from hframe_post.errors import GcodeError
from hframe_post.firmware.registry import FIRMWARES
from hframe_post.printer.settings import Printer
from hframe_post.studies.print_comparison import Comparison, Tolerance, compare
from tests.conftest import SAMPLES

KLIPPER, MARLIN = (FIRMWARES[name].dialect for name in ("klipper", "marlin"))

PART = b"""M104 S200
G28
G1 X10 Y10 F6000
G1 X20 Y10 E1
;TYPE:FILL
G1 X20 Y30 E3
M106 S100
G1 X10 Y10 Z1 E5 F3000
;TIME_ELAPSED:12.5
G92 E0
G1 E-1 F1800
"""


def compared(a: bytes, b: bytes, place: float = 1e-3, slack: float = 1e-3) -> Comparison:
    lines_a, lines_b = a.splitlines(keepends=True), b.splitlines(keepends=True)
    return compare(lines_a, lines_b, KLIPPER, Tolerance(place, slack))


def changed(old: bytes, new: bytes) -> bytes:
    assert old in PART
    return PART.replace(old, new)


@pytest.mark.parametrize(
    "same",
    [
        changed(b"G1 X20 Y30 E3", b"G1 X20 Y15 E1.5\nG1 X20 Y30 E3"),  # cut in two
        changed(b"G1 X20 Y30 E3", b"g1y30x20.0e+3 ; a"),
        changed(b"X20 Y30", b"X20.0004 Y30"),
        changed(b"F3000", b"F3000.05"),
        changed(b"12.5", b"13.125"),
        changed(b"\n", b"\r\n"),
        b"; processed by hframe-post 9, printer p\n; hframe-post: a\n; hframe-post: b\n" + PART,
        changed(b"G92 E0", b"G92 E0.0004"),
    ],
)  # fmt: skip
def test_another_spelling_of_the_same_motion_is_the_same(same: bytes) -> None:
    assert compared(PART, same).same
    assert compared(same, PART).same


@pytest.mark.parametrize(
    ("other", "what", "line"),
    [
        (changed(b"X20 Y30", b"X20.002 Y30"), "X +0.002 mm", 6),
        (changed(b"Y30 E3", b"Y30 E3.01"), "E +0.01 mm", 6),
        (changed(b"X10 Y10 Z1", b"X10 Y10 Z1.01"), "elsewhere: Z +0.00998 mm", 8),
        (changed(b"F3000", b"F3100"), "another time", 8),
        (changed(b"S100", b"S101"), "another line", 7),
        (changed(b";TYPE:FILL\n", b""), "another line", 5),
        (changed(b"G92 E0", b"G92 E1"), "another line", 10),
        (changed(b"G1 E-1 F1800\n", b""), "E +1 mm", 11),
        (changed(b"M106", b"G4 P500\nM106"), "500 ms longer", 6),
        (changed(b"G28", b"G28\nG4 P500"), "another time", 3),
        (changed(b"F1800\n", b"F1800\n;end\n"), "another line", None),
    ],
)
def test_the_first_difference_is_named(other: bytes, what: str, line: int | None) -> None:
    forwards = compared(PART, other)
    assert forwards.difference is not None
    assert what in forwards.difference.what
    assert forwards.difference.a == line
    assert what in forwards.as_text()
    assert not compared(other, PART).same


def test_small_differences_in_time_add_up() -> None:
    part = b"G1 X10 F6000\n;a\nG1 X0\n;a\n" * 500
    late = part.replace(b"F6000", b"F5994")  # 0.1 ms in each section
    difference = compared(part, late).difference
    assert difference is not None
    assert "later" in difference.what


def test_the_firmware_decides_what_e_means() -> None:
    whole = b"G91\nM82\nG1 X5 E1\nG1 X5 E2\n".splitlines()
    cut = b"G91\nM82\nG1 X5 E1\nG1 X2.5 E1.5\nG1 X2.5 E2\n".splitlines()
    assert compare(whole, cut, MARLIN).same
    assert not compare(whole, cut, KLIPPER).same  # E is relative there, as X is


def test_arcs_by_centre_and_by_radius_are_the_same() -> None:
    by_centre = b"G1 X10 Y0 F600\nG3 X0 Y10 I-10 J0 E1\nG2 X0 Y10 I5 J0\n"
    by_radius = b"G1 X10 Y0 F600\nG3 X0 Y10 R10 E1\nG2 X0 Y10 I5\n"
    assert compared(by_centre, by_radius).same
    flat = compared(by_centre, by_centre.replace(b"I-10 J0", b"I0 J10")).difference
    assert flat is not None
    assert flat.a == 2


def test_an_error_names_the_file_and_line() -> None:
    with pytest.raises(GcodeError, match="b: line 3: a word or number cannot be read"):
        compared(PART, changed(b"X10 Y10 F6000", b"X1.0.0 Y10"))


@given(st.integers(0, 11), st.lists(st.floats(0.05, 0.95), max_size=3, unique=True))
def test_cutting_moves_changes_nothing(turn: int, cuts: list[float]) -> None:
    """Straight moves in pieces, with E along them: the same motion."""
    x, y, e = 10.0 + 3.0 * turn, 40.0 - 2.5 * turn, 1.0 + 0.1 * turn
    whole = f"G1 X5 Y5 F4200\nG1 X{x} Y{y} E{e}\n;end\n"
    pieces = "".join(
        f"G1 X{5 + s * (x - 5):.6f} Y{5 + s * (y - 5):.6f} E{s * e:.7f}\n" for s in sorted(cuts)
    )
    cut = whole.replace("F4200\n", "F4200\n" + pieces)
    assert compared(whole.encode(), cut.encode(), place=1e-5).same


@pytest.fixture(scope="module")
def converted(tmp_path_factory: pytest.TempPathFactory, paper: Printer) -> dict[str, Path]:
    """A sample converted in several ways."""
    folder = tmp_path_factory.mktemp("converted")
    paths = {name: folder / f"{name}.gcode" for name in ("usual", "dense", "fbs")}
    part = SAMPLES / "rectangle.gcode"
    hp.convert(part, paths["usual"], paper)
    hp.convert(part, paths["dense"], paper, hp.Options(tolerance=None))
    hp.convert(part, paths["fbs"], paper, hp.Options("fbs"))
    return paths


def test_decimation_is_within_its_tolerance_and_strategies_differ(
    converted: dict[str, Path],
) -> None:
    usual, dense, fbs = converted["usual"], converted["dense"], converted["fbs"]
    same = hp.testing.assert_same_motion(usual, dense, tolerance=1.5 * TOLERANCE)
    assert same.moves[1] > 3 * same.moves[0]
    with pytest.raises(AssertionError, match="different: b ") as failure:
        hp.testing.assert_same_motion(usual, fbs)
    assert re.search(r"a, line \d+: X[\d.]+ Y[\d.]+", str(failure.value))
    with pytest.raises(AssertionError):
        hp.testing.assert_same_motion(usual, dense, tolerance=TOLERANCE / 10.0)
