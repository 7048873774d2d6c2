"""The README's words are true: its commands run, its sample output is what comes out."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from hframe_post.cli import main
from tests.conftest import ROOT

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


PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page: Path) -> None:
    for target in re.findall(r"\]\((?!http)([^)#]+)", page.read_text()):
        assert (page.parent / target).exists(), target


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_commands_shown_are_those_of_the_tool(page: Path) -> None:
    """Each option of each command line, looked up among that command's parameters."""
    for line in re.findall(r"hframe-post ([^#`\n]*)", page.read_text()):
        words = line.split()
        names = [word for word in words if not word.startswith("-")]
        chosen = main.main.commands.get(names[0] if names else "", main.main.commands["convert"])
        known = {option for parameter in chosen.params for option in parameter.opts}
        for word in words:
            if word.startswith("-") and word not in ("-", "--help", "-h"):
                assert word in known, f"{page.name}: {line}"
