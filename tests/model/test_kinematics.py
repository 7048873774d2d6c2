"""x, y ↔ belts, and printers that do not rack."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from hframe_post.conversion.pipeline import Options, convert
from hframe_post.conversion.report import Report
from hframe_post.firmware.klipper import StreamLimits
from hframe_post.model.kinematics import ROWS, Kinematics
from hframe_post.printer.profile import load, parse
from tests.conftest import SAMPLES

ALL = [
    Kinematics(kind, swap, (a, b))
    for kind, swap, a, b in itertools.product(ROWS, (False, True), (1.0, -1.0), (1.0, -1.0))
]
X, Y = np.array([3.0, -1.0, 0.0]), np.array([4.0, 0.5, 2.0])


def test_belts_of_an_h_frame_are_sum_and_difference() -> None:
    np.testing.assert_array_equal(Kinematics().belts(X, Y), [X + Y, X - Y])
    np.testing.assert_array_equal(Kinematics("corexy").belts(X, Y), [X + Y, X - Y])
    np.testing.assert_array_equal(Kinematics("cartesian").belts(X, Y), [X, Y])


def test_motors_are_exchanged_then_turned() -> None:
    turned = Kinematics("hbot", swap=True, signs=(-1.0, 1.0))
    np.testing.assert_array_equal(turned.belts(X, Y), [-(X - Y), X + Y])


@pytest.mark.parametrize("kinematics", ALL)
def test_matrix_is_that_of_the_belts_and_can_be_undone(kinematics: Kinematics) -> None:
    belts = kinematics.belts(X, Y)
    np.testing.assert_array_equal(kinematics.matrix @ np.stack([X, Y]), belts)
    np.testing.assert_allclose(np.linalg.solve(kinematics.matrix, belts), [X, Y], atol=1e-12)


@pytest.mark.parametrize("kinematics", ALL)
def test_reach_is_the_fastest_direction_that_both_belts_allow(kinematics: Kinematics) -> None:
    angle = np.linspace(0.0, 2.0 * np.pi, 721)
    belts = np.abs(kinematics.belts(np.cos(angle), np.sin(angle))).max(axis=0)
    assert kinematics.reach == pytest.approx((1.0 / belts).max())


def test_stream_of_a_cartesian_printer_may_be_faster_than_its_belts() -> None:
    profile = load("example-cartesian")
    stream = StreamLimits.of(profile.limits, profile.motors, profile.kinematics)
    assert stream.velocity > np.sqrt(2.0) * profile.motors.belt_velocity
    square = StreamLimits.of(profile.limits, profile.motors, Kinematics("corexy"))
    assert stream.acceleration == pytest.approx(np.sqrt(2.0) * square.acceleration)


@pytest.mark.parametrize("change", ["swap = true", "signs = [-1, 1]", "type = 'hbot'"])
def test_stream_in_x_and_y_does_not_know_how_the_motors_are_connected(change: str) -> None:
    mine = parse(f'extends = "paper"\n[kinematics]\n{change}\n', "mine")
    paper = load("paper")
    lines = (SAMPLES / "rectangle.gcode").read_bytes().splitlines(keepends=True)
    texts = []
    for profile in (mine, paper):
        output = list(convert(iter(lines), profile, Options("racking"), Report("racking")))
        texts.append(output[1:])  # without the stamp
    assert texts[0] == texts[1]


@pytest.mark.parametrize("name", ["example-corexy", "example-cartesian"])
@pytest.mark.parametrize("strategy", ["racking", "fbs", "none"])
@pytest.mark.parametrize("part", ["rectangle", "cube"])
def test_examples_convert_the_samples(name: str, strategy: str, part: str) -> None:
    lines = (SAMPLES / f"{part}.gcode").read_bytes().splitlines(keepends=True)
    if part == "cube":
        lines = lines[: lines.index(b";LAYER:4\n")]
    options, report = Options(strategy, ("none", strategy)), Report(strategy)
    for _ in convert(iter(lines), load(name), options, report):
        pass
    error = report.as_json()["contour_error_um"]
    assert report.moves >= 4
    assert strategy == "none" or error[strategy]["rms"] < error["none"]["rms"] / 8


def test_without_racking_both_compensations_are_one() -> None:
    lines = (SAMPLES / "rectangle.gcode").read_bytes().splitlines(keepends=True)
    texts = [
        list(convert(iter(lines), load("example-corexy"), Options(name), Report(name)))[1:]
        for name in ("racking", "fbs")
    ]
    assert texts[0] == texts[1]
