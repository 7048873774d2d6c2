"""Simulated prints: strategies in their order, parts that add up to the whole, any cut."""

from operator import attrgetter
from pathlib import Path
from statistics import median

import numpy as np
import pytest

from hframe_post import library
from hframe_post.conversion.options import Options
from hframe_post.model.strategies import STRATEGIES
from hframe_post.prediction.statistics import TRAVEL
from hframe_post.printer import profile
from hframe_post.printer.settings import Printer
from hframe_post.studies.inputs import rectangle
from hframe_post.studies.simulation import Group, SimulationReport, Study, simulate
from hframe_post.studies.tuning import tune
from hframe_post.studies.uncertainty import draws
from tests.conftest import SAMPLES, few

ALL = tuple(STRATEGIES)


def sample(name: str, last: int | None = None) -> list[bytes]:
    """A sample, or its head up to a layer."""
    lines = (SAMPLES / name).read_bytes().splitlines(keepends=True)
    return lines if last is None else lines[: lines.index(b";LAYER:%d\n" % last)]


def simulated(
    lines: list[bytes], study: Study | None = None, strategies: tuple[str, ...] = ALL
) -> SimulationReport:
    paper = profile.load("paper")
    options = Options("racking", strategies)
    return simulate(lambda: lines, paper, options, study or Study(paper.plant))


def rms(group: Group) -> list[float]:
    return [group[name].contour.rms for name in ALL]


@pytest.fixture(scope="module")
def cube() -> SimulationReport:
    return simulated(sample("cube.gcode", 3))


PARTS = [("rectangle.gcode", None), ("cube.gcode", 3), ("prism.gcode", 1)]


@pytest.mark.parametrize(("name", "last"), few(PARTS, 2))
def test_each_strategy_is_better_than_the_one_before(name: str, last: int | None) -> None:
    none, fbs, racking = rms(simulated(sample(name, last)).parts.whole)
    assert none > fbs > 2.0 * racking > 0.0


def test_layers_and_features_add_up_to_the_whole(cube: SimulationReport) -> None:
    assert {"0", "1", "2"} <= cube.parts.layers.keys()
    assert {TRAVEL, "WALL-OUTER", "WALL-INNER"} <= cube.parts.features.keys()
    for groups in (cube.parts.layers, cube.parts.features):
        for name, whole in cube.parts.whole.items():
            parts = [group[name] for group in groups.values()]
            for of in (attrgetter("extruding"), attrgetter("all")):
                contours, sum_of_all = [of(part.contour) for part in parts], of(whole.contour)
                assert sum(c.count for c in contours) == sum_of_all.count > 0
                assert sum(c.squares for c in contours) == pytest.approx(sum_of_all.squares)
                assert max(c.peak for c in contours) == sum_of_all.peak
                np.testing.assert_array_equal(
                    sum(c.histogram for c in contours), sum_of_all.histogram
                )
            np.testing.assert_allclose(sum(part.tracking for part in parts), whole.tracking)
            assert max(part.velocity for part in parts) == whole.velocity
            assert max(part.acceleration for part in parts) == whole.acceleration


@pytest.mark.paper
def test_racking_with_5_percent_model_error_beats_fbs_without() -> None:
    paper = profile.load("paper")
    study = Study(paper.plant, {0.05: draws(paper.plant, 0.05, 50, 0)})
    report = simulated(rectangle(paper), study)
    (error,) = report.model_error
    assert len(error.rms("racking")) == 50
    assert median(error.rms("racking")) < report.parts.whole["fbs"].contour.rms
    assert error.better("racking", "none") == 50


def layered(squeezed: int) -> list[bytes]:
    """Eight layers of one stroke each; one of them is fast and so the worst."""
    lines = [b"G28\n", b"M83\n", b"M204 S10000\n", b"G1 Z0.2 F600\n", b"G0 X140 Y100 F9000\n"]
    for k in range(8):
        x = 260 if k % 2 == 0 else 140
        feed = 9000 if k == squeezed else 1200
        lines += [b";LAYER:%d\n" % k, b";TYPE:FILL\n", b"G1 X%d E4 F%d\n" % (x, feed)]
    return lines


def test_text_shows_the_worst_layers() -> None:
    lines = simulated(layered(6)).as_text().splitlines()
    heading = next(k for k, line in enumerate(lines) if line.startswith("worst of 8 layers"))
    assert lines[heading + 1].split()[0] == "6"


def test_tune_simulate_and_convert_agree(paper: Printer, tmp_path: Path) -> None:
    lines = rectangle(paper)
    (trial,) = tune(list(lines), paper, [paper.compensation.windows], [])
    simulated = library.simulate(lines, paper).parts.whole["racking"]
    assert trial.contour.rms == pytest.approx(
        simulated.contour.rms, rel=2e-3
    )  # of what lines leave
    assert trial.contour.all.count == simulated.contour.all.count
    converted = library.convert(lines, tmp_path / "out.gcode", paper).peaks
    assert converted.belt_acceleration > 1000.0
    assert simulated.acceleration == pytest.approx(converted.belt_acceleration, rel=1e-6)
    assert trial.acceleration == pytest.approx(converted.belt_acceleration, rel=1e-6)
    assert trial.velocity == pytest.approx(converted.belt_velocity, rel=1e-6)
