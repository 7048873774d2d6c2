"""Simulated prints: strategies in their order, parts that add up to the whole, any cut."""

from itertools import pairwise
from operator import attrgetter
from pathlib import Path
from statistics import median

import numpy as np
import pytest

from hframe_post import library
from hframe_post.conversion.options import Options
from hframe_post.model.impulse_response import ImpulseResponse
from hframe_post.model.plant import Plant
from hframe_post.model.strategies import STRATEGIES
from hframe_post.prediction.statistics import TRAVEL
from hframe_post.printer import profile
from hframe_post.printer.settings import Printer
from hframe_post.studies.simulation import Group, SimulationReport, Study, simulate
from hframe_post.studies.tuning import RACKING, rectangle, tried
from tests.conftest import few
from tests.gcode_tools import layers, sample

ALL = tuple(STRATEGIES)


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
    return simulated(layers("cube.gcode", 3))


@pytest.mark.parametrize("name", few(["rectangle.gcode", "prism.gcode"], 1))
def test_each_strategy_is_better_than_the_one_before(cube: SimulationReport, name: str) -> None:
    lines = sample(name) if name == "rectangle.gcode" else layers(name, 1)
    for report in (cube, simulated(lines)):
        none, fbs, racking = rms(report.parts.whole)
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
    study = Study(paper.plant, {0.05: paper.plant.drawn(0.05, 50, 0)})
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
    trial = tried(lines, paper, paper.compensation.windows, [])
    study = Study(paper.plant, exact=True)  # of commands as computed, as trials are
    simulated = simulate(lambda: lines, paper, RACKING, study).parts.whole["racking"]
    assert trial.contour.rms == simulated.contour.rms
    assert trial.contour.all.count == simulated.contour.all.count
    converted = library.convert(lines, tmp_path / "out.gcode", paper).peaks
    assert converted.belt_acceleration > 1000.0
    assert simulated.acceleration == pytest.approx(converted.belt_acceleration, rel=1e-6)
    assert trial.acceleration == pytest.approx(converted.belt_acceleration, rel=1e-6)
    assert trial.velocity == pytest.approx(converted.belt_velocity, rel=1e-6)


PLANT = profile.load("paper").plant
CARTESIAN = profile.load("example-cartesian").plant


def responses(plant: Plant) -> list[ImpulseResponse]:
    return [G for G in (plant.Gxx, plant.Gyy, plant.Gxtheta) if G is not None]


def same(one: Plant, other: Plant) -> bool:
    pairs = zip(responses(one), responses(other), strict=True)
    return one.x_c == other.x_c and all(
        np.array_equal(G.deviation, H.deviation) and G.lag == H.lag for G, H in pairs
    )


def test_equal_seeds_give_equal_printers_and_others_do_not() -> None:
    first, again = (PLANT.drawn(0.05, 8, seed=1) for _ in range(2))
    assert all(same(a, b) for a, b in zip(first, again, strict=True))
    assert not any(same(a, b) for a, b in zip(first, PLANT.drawn(0.05, 8, 2), strict=True))
    assert not any(same(a, b) for a, b in pairwise(first))


@pytest.mark.parametrize("plant", [PLANT, CARTESIAN], ids=["hbot", "cartesian"])
def test_no_model_error_is_the_plant_itself(plant: Plant) -> None:
    for drawn in plant.drawn(0.0, 3, seed=0):
        assert (drawn.x_c, drawn.Gxtheta is None) == (plant.x_c, plant.Gxtheta is None)
        assert same(drawn, plant)
