"""The examples run as they are, and what they show is what the rest of the project shows."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

import hframe_post as hp
from tests.conftest import ROOT, SAMPLES


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
