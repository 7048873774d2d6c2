"""``hframe-post compare``: exit statuses and messages."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.command_line import RECTANGLE, run


@pytest.fixture
def moved(tmp_path: Path) -> Path:
    path = tmp_path / "moved.gcode"
    text = RECTANGLE.read_bytes()
    assert b"G1 X260 Y120" in text
    path.write_bytes(text.replace(b"G1 X260 Y120", b"G1 X260.0015 Y120", 1))
    return path


def test_status_and_first_difference(moved: Path) -> None:
    assert run("compare", RECTANGLE, RECTANGLE).returncode == 0
    different = run("compare", RECTANGLE, moved)
    assert different.returncode == 1
    assert b"b is elsewhere: X +0.0015 mm" in different.stdout
    assert run("compare", RECTANGLE, moved, "--tolerance", "2um").returncode == 0
    assert run("compare", RECTANGLE, moved, "--tolerance", "2um,1s").returncode == 0
    assert run("compare", RECTANGLE, moved, "-q").stdout == b""


def test_standard_input_and_json(moved: Path) -> None:
    done = run("compare", RECTANGLE, "-", "--json", "-", stdin=moved.read_bytes())
    summary = json.loads(done.stdout)
    assert summary["same"] is False
    assert summary["first_difference"]["what"].startswith("b is elsewhere")


@pytest.mark.parametrize(
    "bad", ["0", "-1um", "1 parsec", "nan", "um", "1um,", "1um,1mm", "1", "0.001", "1um,1"]
)
def test_a_tolerance_must_be_a_length(bad: str) -> None:
    assert run("compare", RECTANGLE, RECTANGLE, "--tolerance", bad).returncode == 2


def test_unreadable_files_are_errors(tmp_path: Path) -> None:
    """Status 1 means that the files differ, so an error is 2, as in diff and cmp."""
    missing = run("compare", RECTANGLE, tmp_path / "none.gcode")
    assert missing.returncode == 2
    assert b"none.gcode: No such file" in missing.stderr
    for content in (b"\x7fELF\x00\x00\n", b"\x1f\x8b\x08\x00", b"GCDE\x01\x00", b"G1 XNaN\n"):
        (tmp_path / "bad.gcode").write_bytes(content)
        unreadable = run("compare", RECTANGLE, tmp_path / "bad.gcode")
        assert unreadable.returncode == 2, content
        assert unreadable.stderr.startswith(b"Error: b: "), unreadable.stderr
    assert run("compare", RECTANGLE, tmp_path).returncode == 2
    assert run("compare", RECTANGLE, RECTANGLE, "--json", tmp_path / "no" / "a").returncode == 2
