"""Motors whose limits nobody stated can do what a file asks of the firmware today."""

import math
from dataclasses import replace

import pytest

from hframe_post.gcode.limits import with_motors
from hframe_post.printer.profile import load
from hframe_post.printer.settings import Motors

ASKS = (b"M204 S12000\n", b"SET_VELOCITY_LIMIT ACCEL=12000 SQUARE_CORNER_VELOCITY=4\n")


@pytest.mark.parametrize("line", ASKS)
def test_the_guess_follows_the_file(line: bytes) -> None:
    own = load("example-corexy")
    text = [b"G28\n", b"M204 S99\n", line]
    lines, printer = with_motors(iter(text), own, "file")
    assert list(lines) == text
    assert own.motors.belt_acceleration == round(math.sqrt(2.0) * 12_500)
    assert printer.motors.belt_acceleration == round(math.sqrt(2.0) * 24_000)
    assert with_motors(text, own, "printer")[1].motors == own.motors


def test_what_the_owner_states_stays() -> None:
    guessed = load("example-corexy")
    stated = replace(guessed, motors=Motors(500.0, 9000.0))
    assert with_motors([ASKS[0]], stated, "file")[1] is stated
    weaker = replace(guessed, motors=replace(guessed.motors, belt_acceleration=9000.0))
    assert with_motors([ASKS[0]], weaker, "file")[1].motors.belt_acceleration == 9000.0
