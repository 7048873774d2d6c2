"""One test an equation or figure of the paper, beyond those of the modules that use them."""

import numpy as np
import pytest

from examples.paper import results, tables
from examples.paper.commands import windowed
from hframe_post.arrays import Array
from hframe_post.compensation.compensate import compensate
from hframe_post.model.lpfbs import Window
from hframe_post.model.plant import Plant
from hframe_post.model.strategies import Compensator
from hframe_post.printer import profile
from hframe_post.stream.types import Samples
from tests.gcode_tools import layers

pytestmark = pytest.mark.paper


@pytest.fixture(scope="module")
def plant() -> Plant:
    return profile.load("paper").plant


@pytest.fixture(scope="module")
def rectangle() -> Array:
    return results.path(profile.load("paper"))


@pytest.fixture(scope="module")
def approximations(rectangle: Array) -> list[results.Approximation]:
    return results.approximations(profile.load("paper"), rectangle)


def short_path(n: int) -> Array:
    """A curved path of n samples that begins at rest."""
    t = np.linspace(0.0, 1.0, n)
    return np.column_stack([200.0 + 8.0 * t**3, 100.0 + 5.0 * t**2 * np.sin(3.0 * t)])


# ---------------------------------------------------------------------- Sec. II


def test_tables_i_and_ii_round_to_the_printed_digits() -> None:
    assert max(tables.coefficients_off().values()) <= 1.0


def test_fig_4_racking_resonates_and_vanishes_at_rest(plant: Plant) -> None:
    hz = np.geomspace(0.01, 200.0, 4000)
    magnitude = np.abs(results.frequency_responses(plant, hz).Gxtheta)
    assert 50.0 < hz[magnitude[hz < 100.0].argmax()] < 58.0
    slope = np.diff(np.log(magnitude[:100])) / np.diff(np.log(hz[:100]))
    np.testing.assert_allclose(slope, 1.0, atol=0.01)  # one zero at rest


def test_fig_5_axes_follow_slow_commands_and_ring(plant: Plant) -> None:
    hz = np.geomspace(0.01, 200.0, 4000)
    responses = results.frequency_responses(plant, hz)
    for response, resonance in ((responses.Gxx, (11.0, 15.0)), (responses.Gyy, (13.0, 17.0))):
        magnitude = np.abs(response)
        assert magnitude[0] == pytest.approx(1.0, abs=1e-3)
        assert resonance[0] < hz[magnitude.argmax()] < resonance[1]
        assert magnitude[-1] < 0.3


# ---------------------------------------------------------------------- Appendix B, C


@pytest.mark.parametrize("effort", [0.0, 96.0])
def test_eq_43_is_what_is_streamed(plant: Plant, effort: float) -> None:
    """Window by window with provisional p_x,C, or streamed with x finished: 0.1 µm apart."""
    windows = (Window(5, 88, 44, effort), Window(5, 88, 44, effort))
    xy = np.pad(short_path(700), ((440, 440), (0, 0)), mode="edge")
    ours = streamed(plant, windows, xy)
    np.testing.assert_allclose(windowed(plant, windows, xy, coupled=False), ours, atol=1e-4)


def streamed(plant: Plant, windows: tuple[Window, Window], xy: Array) -> Array:
    xyze, line = np.pad(xy, ((0, 0), (0, 2))), np.zeros(len(xy), np.int64)
    blocks = compensate([Samples(0, xyze, line)], Compensator(plant, windows), ("racking",))
    return np.concatenate([block.commands["racking"] for block in blocks])


# ---------------------------------------------------------------------- Sec. IV


def test_fig_7_has_the_papers_number_of_points(rectangle: Array) -> None:
    assert len(rectangle) == 1944
    acceleration = np.abs(np.diff(rectangle, n=2, axis=0)) / 1e-6
    assert acceleration.max() == pytest.approx(1e4, rel=0.01)


@pytest.mark.slow
def test_fig_8_decoupled_is_as_good_as_coupled(approximations: list[results.Approximation]) -> None:
    """Within 20 % at 0.15 E, as in the paper. From 0.20 E on both are below 1.5 µm, of 242 µm
    without control; there the coupled one is better by more than 20 % of the very little left.
    """
    for row in approximations:
        decoupled, coupled = row.rms
        if row.share == 0.15:
            assert decoupled == pytest.approx(coupled, rel=0.2)
        if row.share >= 0.15:
            assert decoupled == pytest.approx(coupled, abs=1e-3)
            assert max(row.rms) < 1.5e-3


def test_fig_9_racking_compensation_at_125_control_points(rectangle: Array) -> None:
    rms = {
        row.name: row.rms * 1e3 for row in results.time_responses(profile.load("paper"), rectangle)
    }
    assert rms["fbs"] == pytest.approx(117, abs=3)  # calibrated
    assert rms["racking"] <= 12
    assert rms["fbs"] / rms["racking"] >= 9.5
    assert rms["none"] > rms["fbs"]


@pytest.mark.slow
@pytest.mark.parametrize("printed_window", [False, True], ids=["shipped", "printed"])
def test_fig_11_width_of_the_prism(printed_window: bool) -> None:
    """At least what the paper measured on printed parts: 43 % below fbs, 68 % below none."""
    found = results.widths(profile.load("paper"), layers("prism.gcode", 9), printed_window)
    assert found.error["racking"].shape == (9, 3)
    assert found.rms("racking") <= (1 - 0.43) * found.rms("fbs")
    assert found.rms("racking") <= (1 - 0.68) * found.rms("none")
