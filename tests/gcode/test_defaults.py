"""What commands mean without their words, where firmwares differ."""

from __future__ import annotations

import pytest

from hframe_post.firmware.dialect import Dialect
from hframe_post.firmware.klipper.firmware import Klipper
from hframe_post.firmware.marlin.firmware import Marlin
from hframe_post.gcode.reader import read
from hframe_post.gcode.state import ReadOptions
from hframe_post.stream.types import Moves, Passthrough
from tests.klipper.head import head

START = ["G90", "M83", "G1 X10 Y10 Z.2 F6000"]


def last(lines: list[str], dialect: Dialect) -> tuple[float, float]:
    """Return x and the speed of the last move, mm and mm/s."""
    text = [line.encode() for line in [*START, *lines]]
    moves = [item for item in read(text, ReadOptions(dialect)) if isinstance(item, Moves)]
    return float(moves[-1].points[-1, 0]), float(moves[-1].speed[-1])


@pytest.mark.parametrize(
    ("lines", "klipper", "marlin"),
    [
        (["M220 S50", "M220", "G1 X20"], (20.0, 100.0), (20.0, 50.0)),
        (["M220 S50", "M220 R", "G1 X20"], (20.0, 100.0), (20.0, 100.0)),
        (["M220 B", "M220 S50", "M220 R", "G1 X20"], (20.0, 100.0), (20.0, 100.0)),
        (["M220 S50 B", "M220 S200", "M220 R", "G1 X20"], (20.0, 100.0), (20.0, 100.0)),
        (["G1 X20", "G92", "G1 X10 Y10 Z.2", "G1 X30"], (50.0, 100.0), (30.0, 100.0)),
        (["G1 X20", "G92 X5", "G1 X10"], (25.0, 100.0), (25.0, 100.0)),
        (["G1 X20", "G91", "G1 X5"], (25.0, 100.0), (25.0, 100.0)),
    ],
)
def test_what_words_left_out_mean(
    lines: list[str], klipper: tuple[float, float], marlin: tuple[float, float]
) -> None:
    assert last(lines, Klipper.dialect) == pytest.approx(klipper)
    assert last(lines, Marlin.dialect) == pytest.approx(marlin)
    places, _ = head([*START, *lines])  # Klipper's own
    assert places[-1, 0] == pytest.approx(klipper[0])


@pytest.mark.parametrize(
    ("line", "klipper", "marlin"),
    [("G4", 0.0, 0.0), ("G4 S2", 0.0, 2.0), ("G4 P500", 0.5, 0.5), ("G4 P500 S2", 0.5, 2.0)],
)
def test_how_long_a_dwell_is(line: str, klipper: float, marlin: float) -> None:
    for dialect, expected in ((Klipper.dialect, klipper), (Marlin.dialect, marlin)):
        items = list(read([each.encode() for each in [*START, line]], ReadOptions(dialect)))
        (dwell,) = (i for i in items if isinstance(i, Passthrough) and i.text[:2] == b"G4")
        assert dwell.seconds == expected
