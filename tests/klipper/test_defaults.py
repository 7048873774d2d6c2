"""What commands mean, where firmwares differ, by Klipper's own modules; what motors are guessed."""

import importlib
import math
import re
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest

from hframe_post.errors import GcodeError
from hframe_post.firmware.base import FirmwareLimits
from hframe_post.firmware.dialect import Dialect
from hframe_post.firmware.registry import Klipper, Marlin
from hframe_post.gcode.commands import uncommented
from hframe_post.gcode.limits import with_motors
from hframe_post.gcode.reader import read
from hframe_post.gcode.state import ReadOptions
from hframe_post.printer.profile import load
from hframe_post.printer.settings import Motors
from hframe_post.stream.types import Moves, Passthrough
from tests.conftest import SAMPLES
from tests.gcode.reading import ends_by_line
from tests.klipper.head import head, parsed, speed
from tests.slices import SLICES

START = ["G90", "M83", "G1 X10 Y10 Z.2 F6000"]
# what both firmwares know and read differently, or without a word: x and feed rate of the last move
MOVES: dict[str, tuple[list[str], tuple[float, float], tuple[float, float]]] = {
    "M220": (["M220 S50", "M220", "G1 X20"], (20.0, 100.0), (20.0, 50.0)),
    "M220 R": (["M220 S50", "M220 R", "G1 X20"], (20.0, 100.0), (20.0, 100.0)),
    "M220 B": (["M220 B", "M220 S50", "M220 R", "G1 X20"], (20.0, 100.0), (20.0, 100.0)),
    "M220 B, S": (["M220 S50 B", "M220 S200", "M220 R", "G1 X20"], (20.0, 100.0), (20.0, 100.0)),
    "M220 B alone": (["M220 S50", "M220 B", "G1 X20"], (20.0, 100.0), (20.0, 50.0)),
    "G92": (["G1 X20", "G92", "G1 X10 Y10 Z.2", "G1 X30"], (50.0, 100.0), (30.0, 100.0)),
    "G92 X": (["G1 X20", "G92 X5", "G1 X10"], (25.0, 100.0), (25.0, 100.0)),
    "G91": (["G1 X20", "G91", "G1 X5"], (25.0, 100.0), (25.0, 100.0)),
    "G1": (["G1 X20", "G1"], (20.0, 100.0), (20.0, 100.0)),
    "G1 F": (["G1 F3000", "G1 X20"], (20.0, 50.0), (20.0, 50.0)),
    "G2 P": (["G2 X20 I5 P3"], (20.0, 100.0), (20.0, 100.0)),
    "G2 without an end": (["G2 I5"], (10.0, 100.0), (10.0, 100.0)),
    "G2 K": (["G2 X20 I5 K3"], (20.0, 100.0), (20.0, 100.0)),
}  # fmt: skip
# E at the end, mm, which begins absolute at 0
FILAMENT: dict[str, tuple[list[str], float, float]] = {
    "G91": (["G91", "G1 X5 E1", "G1 X5 E1"], 2.0, 2.0),
    "G91, M82": (["G91", "M82", "G1 X5 E1", "G1 X5 E1.5"], 2.5, 1.5),
    "M83, G90": (["M83", "G90", "G1 X20 E1", "G1 X30 E1.5"], 2.5, 1.5),
    "G91, G90": (["G91", "G90", "G1 X20 E1", "G1 X30 E1.5"], 1.5, 1.5),
    "G92 E": (["G1 X20 E1", "G92 E0", "G1 X30 E1"], 2.0, 2.0),
    "G92": (["G1 X20 E1", "G92", "G1 X30 E1"], 2.0, 1.0),
}
# accelerations of the next extrusion and travel, from 1000 and 1000 mm/s²
ACCELERATIONS = {
    "M204": ((1000.0, 1000.0), (1000.0, 1000.0)), "M204 S500": ((500.0, 500.0), (500.0, 500.0)),
    "M204 P500": ((1000.0, 1000.0), (500.0, 1000.0)),
    "M204 T500": ((1000.0, 1000.0), (1000.0, 500.0)),
    "M204 P500 T700": ((500.0, 500.0), (500.0, 700.0)),
    "M204 S400 P500 T700": ((400.0, 400.0), (400.0, 400.0)),
    "M204 R500": ((1000.0, 1000.0), (1000.0, 1000.0)),
    "M201 X500": ((1000.0, 1000.0), (1000.0, 1000.0)),
}  # fmt: skip
DWELLS = {
    "G4": (0.0, 0.0), "G4 S2": (0.0, 2.0), "G4 P500": (0.5, 0.5), "G4 P500 S2": (0.5, 2.0),
}  # fmt: skip
TOOL: Any = importlib.import_module("klippy.toolhead").ToolHead
DIALECTS = Klipper.dialect, Marlin.dialect


def moves(lines: list[str], dialect: Dialect, absolute: bool = False) -> list[Moves]:
    start = [line for line in START if line != "M83" or not absolute]
    text = [line.encode() for line in [*start, *lines]]
    options = ReadOptions(dialect, extrusion="absolute")
    return [item for item in read(text, options) if isinstance(item, Moves)]


@pytest.mark.parametrize("name", MOVES)
def test_what_words_left_out_mean(name: str) -> None:
    lines, *expected = MOVES[name]
    for dialect, (x, v) in zip(DIALECTS, expected, strict=True):
        last = moves(lines, dialect)[-1]
        assert (last.points[-1, 0], last.speed[-1]) == pytest.approx((x, v))
    places, _ = head([*START, *lines])  # Klipper's own
    assert (places[-1, 0], speed([*START, *lines])) == pytest.approx(expected[0])


DRAWN = re.compile(rb"\s*(?:N\d+\s*)?(?:G0?[0-3]|G9[012]|M8[23])(?!\d)", re.IGNORECASE)
FILES = [
    *(each.lines for each in SLICES.values()),
    (SAMPLES / "cube.gcode").read_bytes().splitlines(),
]


@pytest.mark.parametrize("text", FILES, ids=[*SLICES, "cube"])
def test_lines_end_where_klippers_own_end(text: list[bytes]) -> None:
    """What draws in the dialects of many slicers, with arcs, modes and G92."""
    drawn = [uncommented(line).strip() for line in text if DRAWN.match(line)][:3000]
    lines = [b"G92 X0 Y0 Z0", b"G1 F3000", *drawn]
    places, before = head(line.decode() for line in lines)
    ends = ends_by_line(lines, ReadOptions(Klipper.dialect, extrusion="absolute"))
    after = [*before[1:], len(places)]
    for line, end in ends.items():
        assert places[after[line - 1] - 1, :3] == pytest.approx(end, abs=1e-9), lines[line - 1]
    assert len(ends) > 5


@pytest.mark.parametrize("name", FILAMENT)
def test_what_is_fed(name: str) -> None:
    lines, *expected = FILAMENT[name]
    for dialect, e in zip(DIALECTS, expected, strict=True):
        assert moves(lines, dialect, absolute=True)[-1].points[-1, 3] == pytest.approx(e)
    assert head([START[0], START[2], *lines])[0][-1, 3] == pytest.approx(expected[0])


@pytest.mark.parametrize("line", ACCELERATIONS)
def test_accelerations(line: str) -> None:
    start = FirmwareLimits(load("paper").limits, 1000.0, 1000.0, 5.0)
    for dialect, expected in zip(DIALECTS, ACCELERATIONS[line], strict=True):
        text = [each.encode() for each in [*START, line, "G1 X20 E1", "G1 X30"]]
        options = ReadOptions(dialect, start=start)
        (found,) = (item for item in read(text, options) if isinstance(item, Moves))
        assert found.acceleration.tolist() == list(expected)
    asked = of_toolhead(line)
    assert asked == ACCELERATIONS[line][0][0]


def of_toolhead(line: str) -> float:
    """Return the acceleration that Klipper's own toolhead has after a line, from 1000 mm/s²."""
    tool = SimpleNamespace(max_accel=1000.0, _calc_junction_deviation=lambda: None)
    name = line.partition(" ")[0]
    if handler := getattr(TOOL, f"cmd_{name}", None):
        handler(tool, parsed(line))
    return float(tool.max_accel)


@pytest.mark.parametrize("line", DWELLS)
def test_how_long_a_dwell_is(line: str) -> None:
    waited: list[float] = []
    TOOL.cmd_G4(SimpleNamespace(dwell=waited.append), parsed(line))
    assert waited == [DWELLS[line][0]]
    for dialect, expected in zip(DIALECTS, DWELLS[line], strict=True):
        items = list(read([each.encode() for each in [*START, line]], ReadOptions(dialect)))
        (dwell,) = (i for i in items if isinstance(i, Passthrough) and i.text[:2] == b"G4")
        assert dwell.seconds == expected


@pytest.mark.parametrize("feed", ["F0", "F-600"])
def test_no_feed_rate(feed: str) -> None:
    """Marlin keeps the last one; Klipper stops the print."""
    (found,) = moves([f"G1 X20 {feed}"], Marlin.dialect)
    assert found.speed.tolist() == [100.0]
    with pytest.raises(GcodeError, match="feed rate"):
        moves([f"G1 X20 {feed}"], Klipper.dialect)
    with pytest.raises(ValueError, match="Unable to parse"):
        head([*START, f"G1 X20 {feed}"])


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
