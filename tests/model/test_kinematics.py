"""x, y ↔ belts, and printers that do not rack."""

import itertools

import numpy as np
import pytest

from hframe_post.conversion.options import Options
from hframe_post.conversion.whole_file import WholeFile
from hframe_post.errors import PrinterError
from hframe_post.model.kinematics import TYPES, Kinematics
from hframe_post.printer.profile import load, parse
from tests.gcode_tools import converted, sample
from tests.same_print import unstamped

ALL = [
    Kinematics(kind, swap, (a, b))
    for kind, swap, a, b in itertools.product(TYPES, (False, True), (1.0, -1.0), (1.0, -1.0))
]
LINES = sample("rectangle.gcode")
X, Y = np.array([3.0, -1.0, 0.0]), np.array([4.0, 0.5, 2.0])


def test_belts_of_an_h_frame_are_sum_and_difference() -> None:
    np.testing.assert_array_equal(Kinematics().belts(X, Y), [X + Y, X - Y])
    np.testing.assert_array_equal(Kinematics("corexy").belts(X, Y), [X + Y, X - Y])
    np.testing.assert_array_equal(Kinematics("cartesian").belts(X, Y), [X, Y])
    np.testing.assert_array_equal(Kinematics("hybrid-corexy").belts(X, Y), [X - Y, Y])
    np.testing.assert_array_equal(Kinematics("corexz").belts(X, Y), [X, Y])  # while z stands
    turned = Kinematics("hbot", swap=True, signs=(-1.0, 1.0))
    np.testing.assert_array_equal(turned.belts(X, Y), [-(X - Y), X + Y])


@pytest.mark.parametrize("kinematics", ALL)
def test_matrix_and_speed_ratio_are_those_of_the_belts(kinematics: Kinematics) -> None:
    belts = kinematics.belts(X, Y)
    np.testing.assert_array_equal(kinematics.matrix @ np.stack([X, Y]), belts)
    np.testing.assert_allclose(np.linalg.solve(kinematics.matrix, belts), [X, Y], atol=1e-12)
    angle = np.linspace(0.0, 2.0 * np.pi, 721)
    fastest = (1.0 / np.abs(kinematics.belts(np.cos(angle), np.sin(angle))).max(axis=0)).max()
    assert kinematics.max_speed_ratio == pytest.approx(fastest, rel=5e-3)  # of whole angles


@pytest.mark.parametrize(
    "change", ["swap = true", "signs = [-1, 1]", "swap = true\nsigns = [1, -1]"]
)
def test_stream_in_x_and_y_does_not_depend_on_how_the_motors_are_connected(change: str) -> None:
    mine = parse(f'extends = "paper"\n[kinematics]\n{change}\n', "mine")
    paper = load("paper")
    assert unstamped(converted(LINES, mine)[0]) == unstamped(converted(LINES, paper)[0])


def test_corexz_plays_as_cartesian_but_its_z_steps_with_x() -> None:
    text = 'extends = "example-cartesian"\n[kinematics]\ntype = "{}"\n'
    plays, cartesian = (
        unstamped(converted(LINES, parse(text.format(kind), kind), Options("fbs"))[0])
        for kind in ("corexz", "cartesian")
    )
    assert plays == cartesian
    with pytest.raises(PrinterError, match="the motor of z moves with x"):
        next(WholeFile(iter(LINES), parse(text.format("corexz"), "mine"), Options("fbs")).steps())
