"""The README's commands and the examples run, and print what is shown.

``pytest --update-golden`` writes the present output into the tutorial.
"""

import re
import subprocess
import sys
from pathlib import Path

import pytest

import hframe_post as hp
from tests.command_line import run
from tests.conftest import ROOT, SAMPLES

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


def printed_by(example: str, folder: Path) -> str:
    done = subprocess.run(
        [sys.executable, "-W", "error", "-m", f"examples.{example}", folder], check=True, text=True,
        capture_output=True, cwd=ROOT,
    )  # fmt: skip
    return done.stdout


def drawn_in(folder: Path) -> dict[str, str]:
    return {path.name: path.read_text("utf-8") for path in folder.iterdir()}


@pytest.mark.paper
@pytest.mark.slow
def test_the_papers_figures(tmp_path: Path) -> None:
    """Those of docs/derivations.md, but for the measured times in Fig. 8 and the prism."""
    printed_by("paper.figures", tmp_path / "out")
    drawn = drawn_in(tmp_path / "out")
    assert set(drawn) == {"fig04.svg", "fig05.svg", "fig08.svg", "fig09.svg", "corner.svg"}
    assert all(text.count("<path") > 20 for text in drawn.values())
    labels = re.findall(r"(\w+)\)?: (\d+) µm RMS", drawn["corner.svg"])
    assert labels[:2] == [("compensation", "242"), ("fbs", "117")]
    assert labels[2] in (("racking", "10"), ("racking", "11"))  # 10.5


@pytest.mark.slow
def test_the_papers_rectangle_through_the_library(tmp_path: Path) -> None:
    printed = printed_by("paper_rectangle", tmp_path / "out")
    simulated = hp.simulate(SAMPLES / "rectangle.gcode", hp.load_printer("paper"))
    rms = {name: 1e3 * figures.contour.rms for name, figures in simulated.parts.whole.items()}
    shown = [float(number) for number in re.findall(r"([\d.]+) µm RMS", printed)]
    for strategy, number in zip(("none", "fbs", "racking"), shown, strict=True):
        assert abs(number - rms[strategy]) <= 0.05 * rms[strategy]
    drawn = drawn_in(tmp_path / "out")
    assert set(drawn) == {"plant.svg", "corner.svg", "model_error.svg"}
    assert all(text.count("<path") > 20 for text in drawn.values())
