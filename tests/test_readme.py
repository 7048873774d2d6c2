"""The README's commands run and print what it shows.

``pytest --update-golden`` writes the present output into the tutorial.
"""

import re
from pathlib import Path

import pytest

from tests.command_line import run
from tests.conftest import ROOT

README, TUTORIAL = ROOT / "README.md", ROOT / "docs" / "start.md"


def command(name: str) -> str:
    """Return the shell command under a marker."""
    found = re.search(rf"<!-- {name} command -->\n```sh\n(.+)\n```", README.read_text("utf-8"))
    assert found is not None
    return found[1]


def shown(page: Path, tells: str, now: str, update: bool) -> str:
    """Return the first block of a page with a line that begins with ``tells``."""
    text = page.read_text("utf-8")
    for block in re.finditer(r"^```\w*\n(.*?)^```$", text, re.MULTILINE | re.DOTALL):
        if re.search(rf"^{re.escape(tells)}", block[1], re.MULTILINE):
            if update:
                page.write_text(text[: block.start(1)] + now + text[block.end(1) :], "utf-8")
            return now if update else block[1]
    raise AssertionError(f"{page.name} shows no line that begins with {tells!r}")


@pytest.fixture
def update(request: pytest.FixtureRequest) -> bool:
    return bool(request.config.getoption("--update-golden"))


def test_sample_command(tmp_path: Path, update: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    last = command("sample").split()
    assert last[0] == "hframe-post"
    last[-1] = str(tmp_path / "out.gcode")
    monkeypatch.chdir(ROOT)
    printed = run(*last[1:]).stderr.decode()
    assert printed == shown(TUTORIAL, "print time", printed, update)


def test_test_command_is_what_ci_runs() -> None:
    assert command("test").endswith("make check PYTHON=.venv/bin/python")
    assert "test command" in (ROOT / ".ci" / "run").read_text()
