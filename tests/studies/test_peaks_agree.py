"""All studies report the same peak speed and acceleration of the belts."""

from pathlib import Path

import pytest

from hframe_post import library
from hframe_post.printer.settings import Printer
from hframe_post.studies.inputs import rectangle
from hframe_post.studies.tuning import tune


def test_tune_simulate_and_convert_agree(paper: Printer, tmp_path: Path) -> None:
    lines = rectangle(paper)
    (trial,) = tune(list(lines), paper, [paper.compensation.windows], [])
    simulated = library.simulate(lines, paper).parts.whole["racking"]
    converted = library.convert(lines, tmp_path / "out.gcode", paper).peaks
    assert converted.belt_acceleration > 1000.0
    assert simulated.acceleration == pytest.approx(converted.belt_acceleration, rel=1e-6)
    assert trial.acceleration == pytest.approx(converted.belt_acceleration, rel=1e-6)
    assert trial.velocity == pytest.approx(converted.belt_velocity, rel=1e-6)
