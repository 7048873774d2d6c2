"""The examples run as they are, and what they show is what the rest of the project shows."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import hframe_post as hp
from tests.conftest import ROOT, SAMPLES


def test_the_papers_rectangle_through_the_library(tmp_path: Path) -> None:
    example = ROOT / "examples" / "paper_rectangle.py"
    printed = subprocess.run(
        [sys.executable, "-W", "error", example, tmp_path / "out"], check=True, text=True,
        capture_output=True,
    ).stdout  # fmt: skip
    simulated = hp.simulate(SAMPLES / "rectangle.gcode", hp.load_printer("paper"))
    rms = {name: 1e3 * figures.contour.rms for name, figures in simulated.parts.whole.items()}
    shown = [float(number) for number in re.findall(r"([\d.]+) µm RMS", printed)]
    for strategy, number in zip(("none", "fbs", "racking"), shown, strict=True):
        assert abs(number - rms[strategy]) <= 0.05 * rms[strategy]
    drawn = {path.name: path.read_text("utf-8") for path in (tmp_path / "out").iterdir()}
    assert set(drawn) == {"plant.svg", "corner.svg", "model_error.svg"}
    assert all(text.count("<path") > 20 for text in drawn.values())
