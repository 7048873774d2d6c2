"""The windows that ``identify`` writes for measured responses: known beforehand, not searched."""

from dataclasses import replace

import pytest

from hframe_post.identification.recommend import recommend
from hframe_post.model.impulse_response import ImpulseResponse
from hframe_post.model.lpfbs import Window
from hframe_post.model.plant import Plant
from hframe_post.printer.profile import load
from hframe_post.printer.settings import GuessedMotors, Printer
from tests.plants import deviation_of_mode


def corexy(belt_acceleration: float) -> Printer:
    printer = load("example-corexy")
    motors = replace(printer.motors, belt_acceleration=belt_acceleration, belt_velocity=1000.0)
    return replace(printer, motors=motors)


PLANT = Plant(
    ImpulseResponse(deviation_of_mode(45.0, 0.06, 400), 0, drift=0.02),
    ImpulseResponse(deviation_of_mode(32.0, 0.08, 400), 0, drift=0.02),
    None,
    100.0,
)


@pytest.mark.parametrize(("belts", "guessed"), [(60000.0, True), (5300.0, False)])
def test_measured_responses_get_one_window_whatever_the_belts(belts: float, guessed: bool) -> None:
    """The path is kept within stated motors; a guess grows with the file that is converted."""
    printer = corexy(belts)
    if guessed:
        printer = replace(printer, motors=GuessedMotors(1000.0, belts, (1000.0, belts)))
    found = recommend(PLANT, printer, 0.03)
    assert found is not None
    window = Window(5, 88, 44, 10.0)
    assert found.windows == (window, window)
    assert found.rms("fbs") < 0.1 * found.rms("none")  # µm
