"""G10 and G11 as moves of filament: as often and as far as the firmware, without a trace in E."""

import pytest

from hframe_post.arrays import E
from hframe_post.gcode.extrusion import RETRACTION_S
from hframe_post.printer.settings import Retraction
from hframe_post.stream.types import Item, MoveAtRest, Moves, Passthrough
from tests.gcode.reading import items

OWN = Retraction(length=0.8, speed=40.0, return_speed=30.0, extra=0.1)
HOME = ["G28", "G90", "M82", "G0 X0 Y0 Z0 F6000", "G10", "G11", "G0 X9 F6000"]
PAIR = [(-0.8, 40.0), (0.9, 30.0)]


def found(
    lines: list[str], own: Retraction | None = OWN, firmware: str = "klipper"
) -> tuple[list[tuple[float, float]], list[bytes], list[Item]]:
    """Filament and speed of what stands; G10, G11 and the like that pass; all items."""
    every = items(*lines, firmware=firmware, retraction=own)
    stand = [(round(i.end[E] - i.start[E], 9), i.speed) for i in every if isinstance(i, MoveAtRest)]
    passed = [i.text for i in every if isinstance(i, Passthrough) and i.text[:2] == b"G1"]
    return stand, passed, every


def test_the_first_pair_is_the_firmwares_then_they_are_moves() -> None:
    stand, passed, every = found([*HOME, "G10", "G1 X50", "G11", "G1 X60 E2", "G10", "G11"])
    assert stand == 2 * PAIR
    assert passed == [b"G10", b"G11"]
    printed = [m for m in every if isinstance(m, Moves)][-1]
    assert printed.points[-1, E] - printed.points[0, E] == pytest.approx(2.0)  # E2, from E0


@pytest.mark.parametrize(
    ("lines", "stand"),
    [
        (["G10", "G10", "G11", "G11"], PAIR),  # what a firmware ignores
        (["M83", "G1 X20 E1", "G10", "G1 X30", "G11", "G1 X40 E1"], PAIR),
        (["G92 E0", "G10", "G92 E5", "G11", "G1 X30 E6"], PAIR),
        (["SET_RETRACTION RETRACT_LENGTH=2 UNRETRACT_SPEED=9", "G10", "G11"],
         [(-2.0, 40.0), (2.1, 9.0)]),
        (["M220 S50", "G10", "G11"], [(-0.8, 20.0), (0.9, 15.0)]),
        (["SET_RETRACTION Z_HOP_HEIGHT=0.4", "G10", "G11"], []),  # whose lift is unknown here
        (["SET_RETRACTION RETRACT_LENGTH=0", "G10", "G11"], []),
        (["G10 P0 R160", "G10", "G11"], []),  # a tool's offset: may be a macro
    ],
)  # fmt: skip
def test_what_was_taken_is_brought_back(lines: list[str], stand: list[tuple[float, float]]) -> None:
    assert found([*HOME, *lines])[0] == stand


@pytest.mark.parametrize(
    "between",
    [["TIMELAPSE", "G0 X9 Y9 Z1 F6000"], ["TIMELAPSE"], ["SET_INPUT_SHAPER"], 501 * [";"]],
)
def test_a_pair_with_a_macro_between_stays_the_firmwares(between: list[str]) -> None:
    """Which may call G11 itself, or leave the place unknown where a move of filament would be."""
    stand, passed, _ = found([*HOME, "G10", *between, "G11", "G0 X9 Y9 Z1 F6000", "G10", "G11"])
    assert stand == PAIR
    assert passed == 2 * [b"G10", b"G11"]


@pytest.mark.parametrize(
    ("firmware", "line", "stand"),
    [
        ("marlin", "M207 S1.5 F1200\nM208 S0 F600", [(-1.5, 20.0), (1.5, 10.0)]),
        ("marlin", "M207 S1.5 Z0.3", []),
        ("klipper", "M207 S1.5", PAIR),
    ],
)
def test_settings_of_the_file(firmware: str, line: str, stand: list[tuple[float, float]]) -> None:
    assert found([*HOME, *line.split("\n"), "G10", "G11"], firmware=firmware)[0] == stand


def test_pass_through_retractions_have_an_estimated_duration() -> None:
    """Otherwise a stop of 60 ms is computed as one without duration."""

    def seconds(own: Retraction | None) -> list[float]:
        every = found(["G28", "G10", "G11", "G1 X1 Y1 Z1"], own)[2]
        return [i.seconds for i in every if isinstance(i, Passthrough)][1:3]

    assert seconds(None) == [RETRACTION_S, RETRACTION_S]
    assert seconds(OWN) == pytest.approx([0.8 / 40.0, 0.9 / 30.0])
