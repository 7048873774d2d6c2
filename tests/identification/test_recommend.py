"""The windows that ``identify`` writes for measured responses: known beforehand, not searched."""

from __future__ import annotations

from dataclasses import replace

import pytest

from hframe_post.identification.recommend import recommend
from hframe_post.model.impulse_response import ImpulseResponse
from hframe_post.model.lpfbs import Window
from hframe_post.model.plant import Plant
from hframe_post.printer.profile import load
from hframe_post.printer.settings import Motors, Printer
from tests.modes import deviation_of_mode


def corexy(belt_acceleration: float) -> Printer:
    printer = load("example-corexy")
    motors = replace(printer.motors, belt_acceleration=belt_acceleration, belt_velocity=1000.0)
    return replace(printer, motors=motors, stated=None)


PLANT = Plant(
    ImpulseResponse(deviation_of_mode(45.0, 0.06, 400), 0, drift=0.02),
    ImpulseResponse(deviation_of_mode(32.0, 0.08, 400), 0, drift=0.02),
    None,
    100.0,
)


@pytest.mark.parametrize(("belts", "effort"), [(60000.0, 10.0), (8900.0, 100.0), (5300.0, 100.0)])
def test_measured_responses_get_more_effort_only_where_the_belts_need_it(
    belts: float, effort: float
) -> None:
    found = recommend(PLANT, corexy(belts), 0.03)
    assert found is not None
    window = Window(5, 88, 44, effort)
    assert found.windows == (window, window)
    assert found.rms("fbs") < 0.1 * found.rms("none")  # µm


def test_belts_that_nobody_stated_limit_no_window() -> None:
    """What is guessed of them grows with the file that is converted."""
    guessed = replace(corexy(8900.0), stated=Motors())
    found = recommend(PLANT, guessed, 0.03)
    assert found is not None
    assert found.windows[0].effort == 10.0


def test_belts_that_cannot_follow_the_path_are_refused() -> None:
    assert recommend(PLANT, corexy(5000.0), 0.03) is None
