"""The README's words are true: its commands run, its sample output is what comes out."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

from .conftest import ROOT

README = (ROOT / "README.md").read_text()


def command(name: str) -> str:
    """The shell command under a marker."""
    found = re.search(rf"<!-- {name} command -->\n```sh\n(.+)\n```", README)
    assert found is not None
    return found[1]


def test_sample_command_converts(tmp_path: Path) -> None:
    """Without the part that sets up the virtual environment, which is this one."""
    last = command("sample").split(" && ")[-1].split()
    assert last[0] == ".venv/bin/hframe-post"
    last[-1] = str(tmp_path / "out.gcode")
    arguments = [sys.executable, "-m", "hframe_post", *last[1:]]
    done = subprocess.run(arguments, cwd=ROOT, capture_output=True, check=False)
    assert done.returncode == 0
    told = done.stderr.decode().splitlines()
    shown = README.partition("## What comes out\n\n```\n")[2].partition("\n```")[0].splitlines()
    assert told == shown


def test_test_command_is_what_ci_runs() -> None:
    assert command("test").endswith("make check PYTHON=.venv/bin/python")
    assert "test command" in (ROOT / ".ci" / "run").read_text()


def test_links_lead_somewhere() -> None:
    for target in re.findall(r"\]\((?!http)([^)#]+)", README):
        assert (ROOT / target).exists(), target


def test_commands_of_the_usage_are_options_of_the_tool() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "hframe_post", "convert", "--help"], capture_output=True, check=True
    )
    for option in re.findall(r"(?<![\w-])--[a-z][a-z-]+", README.partition("## Use")[2]):
        assert option.encode() in done.stdout, option
