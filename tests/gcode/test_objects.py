"""The first move of x and y after an object, which firmware may have left out, stays one line."""

import pytest

from hframe_post.firmware.registry import FIRMWARES
from hframe_post.gcode.reader import CHANGE_OF_OBJECT
from hframe_post.stream.types import MoveAtRest, Passthrough
from tests.gcode.reading import items

BEGIN = ["G90", "M83", "G1 X10 Y10 Z.2 F6000"]
WALL = ["G1 X20 Y10 E1", "G1 X20 Y20 E1"]
A, B, END = (f"EXCLUDE_OBJECT_{x}" for x in ("START NAME=A", "START NAME=B", "END"))


def copied(lines: list[str], firmware: str = "klipper") -> list[str]:
    found = items(*BEGIN, *lines, firmware=firmware)
    causes = {i.text.decode(): i.cause for i in found if isinstance(i, Passthrough)}
    return [text for text, cause in causes.items() if cause == CHANGE_OF_OBJECT]


@pytest.mark.parametrize(
    ("lines", "expected"),
    [
        ([A, *WALL, END, B, "G1 E-1", "G1 Z.6", "G1 X50", *WALL], ["G1 X50"]),
        ([A, *WALL, END, "G1 X50", B, *WALL], ["G1 X50"]),  # a travel of no object
        ([A, *WALL, B, "G1 X50 Y50 E1", *WALL], ["G1 X50 Y50 E1"]),
        ([A, *WALL, END, "G1 Z.4", A, "G1 X50", *WALL], []),  # the same: it is out or not
        ([A, *WALL, END, "G1 X50", A, *WALL, END, "G1 X50"], []),  # there is no other
        (["G1 X50", A, *WALL], []),  # what belongs to no object is never left out
        ([A, *WALL, END, B, END, A, "G1 X50"], []),  # nothing of B
        ([A, *WALL, END, B, "G2 X50 Y20 I15 J0", "G1 X5"], ["G2 X50 Y20 I15 J0"]),
        ([A, *WALL, END, B, "G91", "G1 X5", "G1 X5 Y5"], ["G1 X5"]),
        ([A, *WALL, END, B, "G20", "G1 X1.5"], []),  # inches cannot be copied
    ],
)
def test_what_follows_an_object_is_copied(lines: list[str], expected: list[str]) -> None:
    assert copied(lines) == expected


@pytest.mark.parametrize(
    ("first", "second"),
    [
        ("; printing object a id:0 copy 0", "; stop printing object a id:0 copy 0"),
        (";MESH:cube.stl", ";MESH:NONMESH"), (";PRINTING_ID: 1", ";PRINTING_ID: -1"),
        ("M486 S1", "M486 S-1"), ("exclude_object_start NAME=a", "exclude_object_end"),
        ("N5 M486 S1", "M486 A12 S2"), (";MESH:a.stl", ";MESH:b.stl"),
    ],
)  # fmt: skip
def test_labels(first: str, second: str) -> None:
    after = [second, "G1 X50", "M486 S7"]  # a second object
    assert copied([first, *WALL, *after]) == ["G1 X50"]
    assert copied([";TYPE:" + first, *WALL, ";TYPE:" + second, "G1 X50"]) == []
    marlin = copied([first, *WALL, *after], "marlin")
    assert marlin == (["G1 X50"] if "M486" in first else [])


def test_a_spiral_lift_after_an_object_is_a_lift() -> None:
    """Klipper would go to its first chord, next to the object that it left out."""
    found = items(*BEGIN, A, *WALL, END, B, "G3 Z.6 I1.2 J0 P1 F12000", "G1 X50")
    (lift,) = (item for item in found if isinstance(item, MoveAtRest))
    assert (lift.start[:3], lift.end[:3]) == ((20.0, 20.0, 0.2), (20.0, 20.0, 0.6))


@pytest.mark.parametrize(
    "line",
    ["M808 L2", "M808", "SDCARD_LOOP_BEGIN COUNT=2", "SDCARD_LOOP_END", "SDCARD_RESET_FILE", "M24",
     "M25", "M26 S0", "M600", "M0", "PAUSE", "RESUME", "CANCEL_PRINT", "EXCLUDE_OBJECT NAME=a",
     "RESTORE_GCODE_STATE NAME=a MOVE=1", "PARK"],
)  # fmt: skip
def test_after_what_may_leave_the_machine_elsewhere_the_next_move_is_copied(line: str) -> None:
    lines = [*BEGIN, *WALL, line, "G1 X50", "G1 Y30", "G1 X60 Y60"]
    for firmware in FIRMWARES:
        found = items(*lines, firmware=firmware)
        text = [item.text.decode().strip() for item in found if isinstance(item, Passthrough)]
        assert text[text.index(line) :] == [line, "G1 X50", "G1 Y30", ""]
