"""The command line as its users meet it: processes, files, exit statuses."""

import contextlib
import json
import os
import pty
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.command_line import RECTANGLE, run


@pytest.fixture
def part(tmp_path: Path) -> Path:
    return Path(shutil.copy(RECTANGLE, tmp_path / "part.gcode.pp"))


def test_a_second_pass_changes_nothing_and_succeeds(part: Path, tmp_path: Path) -> None:
    run(part)
    once, before = part.read_bytes(), part.stat()
    again = run(part)
    assert again.returncode == 0
    assert again.stderr.decode() == f"{part}: this file is converted already; left as it is\n"
    assert part.read_bytes() == once
    assert part.stat().st_mtime_ns == before.st_mtime_ns
    copied = run(part, "-o", tmp_path / "copy.gcode", "--json", "-", "-q")
    assert (tmp_path / "copy.gcode").read_bytes() == once
    assert "already" in json.loads(copied.stdout)["left_alone"]
    assert not copied.stderr


def test_a_second_pass_with_other_settings_names_the_original(tmp_path: Path) -> None:
    original = Path(shutil.copy(RECTANGLE, tmp_path / "part.gcode"))
    converted = tmp_path / "part.compensated.gcode"
    run(original, "-o", converted)
    once = converted.read_bytes()
    for options in (["-p", "paper-strong", "--force"], ["--limits", "printer"]):
        again = run(converted, *options)
        assert again.returncode == 1
        assert f"Convert {original} instead" in again.stderr.decode()
    as_steps = run(converted, "-o", tmp_path / "steps.csv")
    assert as_steps.returncode == 1
    assert not (tmp_path / "steps.csv").exists()
    original.unlink()
    assert b"Convert the slicer's file instead" in run(converted, "-c", "fbs").stderr
    assert converted.read_bytes() == once


def test_a_file_marked_off_is_left_alone(part: Path) -> None:
    part.write_bytes(part.read_bytes() + b"\n; hframe-post: off\n")
    marked = part.read_bytes()
    done = run(part)
    assert done.returncode == 0
    assert b"not to be converted; left as it is" in done.stderr
    assert part.read_bytes() == marked
    assert run(part, "--report", part.with_name("page.html")).returncode == 1


def test_streams_from_standard_input_to_standard_output(part: Path, tmp_path: Path) -> None:
    run(part, "-o", tmp_path / "out.gcode")
    done = run("-", "-q", stdin=RECTANGLE.read_bytes())
    assert done.stdout == (tmp_path / "out.gcode").read_bytes()
    assert done.stderr == b""


@pytest.mark.parametrize(
    ("text", "cause"),
    [
        (b"", b"the file is empty"),
        (b"GCDE\x01\x00", b"binary G-code"),
        (b"\x1f\x8b\x08\x00" * 9, b"unpack it first"),
        (b"PK\x03\x04\x14\x00", b"export the G-code"),
        ("G1 X10 Y10\n".encode("utf-16"), b"UTF-16, as PowerShell's > writes it"),
        (b"\x7fELF\x00\x00\n", b"not a text file"),
        (b"; only a comment\n", b"not a single move"),
        (b"G1 X10 Y10\nG1 XNaN\n", b"line 2: "),
        (b"G1 X10 Y10\nG1 X20\nG55\n", b"line 3: G55"),
        (b"G1 X10 Y10\nG1 X1000\n", b"line 2: x of the path (mm)"),
    ],
)
def test_bad_input_is_one_line_and_status_1(part: Path, text: bytes, cause: bytes) -> None:
    part.write_bytes(text)
    done = run(part)
    assert done.returncode == 1
    assert cause in done.stderr
    assert done.stderr.count(b"\n") == 1
    assert part.read_bytes() == text
    assert [path.name for path in part.parent.iterdir()] == [part.name]


@pytest.mark.parametrize(
    "arguments", [["--bad"], ["-c", "nonsense"], ["--tolerance", "-1"], ["convert"], ["a", "b"]]
)
def test_wrong_usage_is_status_2(arguments: list[str]) -> None:
    assert run(*arguments).returncode == 2


def test_names_that_begin_with_a_dash(part: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(part.parent)
    part = part.rename("-dash.gcode")
    assert run(part.name).returncode == 2
    for given in ((f"./{part.name}",), ("--", part.name)):
        assert run("-n", "-q", *given).returncode == 0
        assert run("convert", "-n", "-q", *given).returncode == 0
    assert part.read_bytes() == RECTANGLE.read_bytes()


def test_a_mistyped_command_is_answered_with_the_nearest(tmp_path: Path) -> None:
    done = run("simulat", RECTANGLE)
    assert done.returncode == 2
    assert b"did you mean 'hframe-post simulate'?" in done.stderr
    assert b"'job' is neither a command nor a file; see --help" in run("job", RECTANGLE).stderr
    own = Path(shutil.copy(RECTANGLE, tmp_path / "simulat"))
    assert run(own, "-n", "-q").returncode == 0


def test_a_progress_bar_shows_on_a_terminal_only(tmp_path: Path) -> None:
    part = tmp_path / "long.gcode"
    part.write_bytes(RECTANGLE.read_bytes() + (b"; " + b"-" * 500 + b"\n") * 500)
    at_once = (
        "import runpy; from hframe_post.cli import parameters; parameters.LARGE_BYTES = 1; "
        "runpy.run_module('hframe_post', run_name='__main__')"
    )
    ours, theirs = pty.openpty()
    done = subprocess.run(
        [sys.executable, "-c", at_once, str(part), "-n"], stderr=theirs,
        stdout=subprocess.PIPE, check=False, env={**os.environ, "TERM": "xterm"},
    )  # fmt: skip
    os.close(theirs)
    shown = b""
    with contextlib.suppress(OSError):  # the terminal's end
        while piece := os.read(ours, 4096):
            shown += piece
    os.close(ours)
    assert done.returncode == 0
    assert b"long.gcode" in shown
    assert b"100%" in shown
    assert b"100%" not in run(part, "-n").stderr
