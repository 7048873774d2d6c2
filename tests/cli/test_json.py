"""``--json``: what every command writes, also when it fails, and what it never replaces."""

import json
import re
import shutil
from pathlib import Path
from typing import Any

import pytest

from hframe_post.cli.parameters import SCHEMA
from hframe_post.version import __version__
from tests.command_line import COMMANDS, RECTANGLE, run
from tests.conftest import ROOT

OUTSIDE = b"G28\nG1 X10 Y10\nG1 X9999\n"


@pytest.fixture
def outside(tmp_path: Path) -> Path:
    path = tmp_path / "outside.gcode"
    path.write_bytes(OUTSIDE)
    return path


def summary(*arguments: str | Path) -> dict[str, Any]:
    """Return the JSON on standard output, which holds the command's exit status."""
    done = run(*arguments, "--json", "-")
    found: dict[str, Any] = json.loads(done.stdout)
    assert (found["schema"], found["version"]) == (SCHEMA, __version__)
    assert found["status"] == done.returncode, done.stderr
    return found


def test_a_failure_has_its_status_text_and_line(outside: Path, tmp_path: Path) -> None:
    found = summary(outside, "-o", tmp_path / "out.gcode")
    assert (found["command"], found["status"], found["line"]) == ("convert", 1, 3)
    assert found["error"].startswith("line 3: x of the path (mm) would be 9999")
    assert summary(outside, "-n", "-p", "nobody")["error"].startswith("nobody: no such profile")
    assert summary(outside, "-n", "--tolerance", "7")["status"] == 2
    assert summary(tmp_path / "none.gcode", "-n")["error"].endswith("No such file or directory")


WITHOUT_INPUT: dict[str, list[str]] = {
    "convert": ["none.gcode"], "batch": ["none.gcode", "-o", "out"],
    "simulate": ["none.gcode"],
    "identify": ["empty", "-o", "my.toml"], "check": ["empty"],
}  # fmt: skip


@pytest.mark.parametrize("name", WITHOUT_INPUT)
def test_each_command_says_why(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("empty").mkdir()
    done = run(name, *WITHOUT_INPUT[name], "--json", "s.json")
    found = json.loads(Path("s.json").read_text())
    status = {"batch": 2}.get(name, 1)
    assert (done.returncode, found["status"], found["command"]) == (status, status, name)
    assert found["error"] in done.stderr.decode()
    assert {path.name for path in tmp_path.iterdir()} == {"empty", "s.json"}


def test_every_command_with_the_option_is_tried_and_documented() -> None:
    having = {
        name for name, command in COMMANDS.items()
        if any("--json" in parameter.opts for parameter in command.params)
    }  # fmt: skip
    assert having == set(WITHOUT_INPUT)
    page = (ROOT / "docs" / "interfaces.md").read_text()
    assert f'"schema": {SCHEMA}' in page
    assert all(re.search(rf"^\| `{name}`", page, re.MULTILINE) for name in having)


def test_a_failure_replaces_an_earlier_summary_alone(outside: Path, tmp_path: Path) -> None:
    target = tmp_path / "s.json"
    assert run(RECTANGLE, "-n", "-q", "--json", target).returncode == 0
    assert run(outside, "-n", "-q", "--json", target).returncode == 1
    assert json.loads(target.read_text())["line"] == 3
    shutil.copy(RECTANGLE, part := tmp_path / "part.gcode")
    for arguments in (
        (outside, "-n", "--json", part), (outside, "-n", "--json", outside),
        (part, "-n", "-p", "nobody", "--json", part), (part, "-n", "--json", part, "--jobs", "0"),
        (part, "-p", "nobody", "-o", tmp_path / "new", "--json", tmp_path / "new"),
    ):  # fmt: skip
        assert run(*arguments).returncode > 0
    assert (part.read_bytes(), outside.read_bytes()) == (RECTANGLE.read_bytes(), OUTSIDE)
    assert {path.name for path in tmp_path.iterdir()} == {"outside.gcode", "part.gcode", "s.json"}


def test_documented_keys_are_those_of_a_conversion(tmp_path: Path) -> None:
    """The page names every key of the summaries of convert and batch."""
    page = (ROOT / "docs" / "interfaces.md").read_text()
    batch = tmp_path / "batch.json"
    run("batch", RECTANGLE, "-o", tmp_path / "out", "--json", batch)
    batched = json.loads(batch.read_text())
    for found in (summary(RECTANGLE, "-n"), batched, batched["files"][0]):
        missing = [key for key in found if f"`{key}`" not in page and f'"{key}"' not in page]
        assert not missing
