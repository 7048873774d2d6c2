"""Files that would never end, fill the memory, leave the bed or do not say what E is."""

from collections.abc import Iterator
from itertools import repeat

import pytest

from hframe_post.errors import GcodeError, LimitError
from hframe_post.firmware.registry import FIRMWARES
from hframe_post.gcode import batching, lines
from hframe_post.gcode.reader import read
from hframe_post.gcode.state import Extrusion, ReadOptions
from hframe_post.printer.settings import Travel
from hframe_post.stream.marks import Marks
from hframe_post.stream.types import Handling, Item, MoveAtRest, Moves, Passthrough
from tests.conftest import few
from tests.gcode.reading import HOME, carried, items, moves
from tests.gcode_tools import one_by_one

KLIPPER = FIRMWARES["klipper"].dialect

BED = ReadOptions(KLIPPER, travel=Travel((0.0, 200.0), (0.0, 100.0), (-1.0, 50.0)))


def on_bed(*text: str) -> list[Item]:
    return list(read([line.encode() for line in text], BED))


@pytest.mark.parametrize(
    "line",
    [
        "G1 X900 F0.1", "G1 X9 F0.01", "M203 Y0.001", "M204 S0.0000001", "G1 E219414", "M220 S0.01",
        "SET_VELOCITY_LIMIT VELOCITY=1e-3", "G4 P-5000", "G4 P" + "9" * 400,
        "G3 X0 Y0 I900000 J0", "G5 I2 J3 P-2 Q4294967297 X90 Y60",
        "G1 X" + "9" * 5000,
        "G1 X" + "5" * 2_000_000,
    ],
    ids=lambda line: line[:24],
)  # fmt: skip
def test_endless_motion_is_an_error_with_its_line(line: str) -> None:
    with pytest.raises(GcodeError) as caught:
        items(*HOME, line)
    assert caught.value.line == len(HOME) + 1
    assert len(str(caught.value)) < 300


@pytest.mark.parametrize("compiled", [True, False])
def test_filament_without_a_path_is_fed(monkeypatch: pytest.MonkeyPatch, compiled: bool) -> None:
    """The path follows where it is long enough to be written."""
    if not compiled:
        monkeypatch.setattr(batching, "plain_lines", one_by_one)
    text = ("M83", *HOME, "G1 X1 Y1 Z1", "G1 X5 E0.3", "G1 X5.0004 E6", "G1 X9 E0.3")
    found = [i for i in items(*text) if isinstance(i, Moves | MoveAtRest)]
    assert [type(i).__name__ for i in found] == ["Moves", "MoveAtRest", "Moves"]
    _, fed, further = found
    assert isinstance(fed, MoveAtRest)
    assert isinstance(further, Moves)
    assert fed.start[:3] == fed.end[:3] == (5.0, 1.0, 1.0)
    assert fed.end[3] - fed.start[3] == pytest.approx(6.0)
    assert further.points[0].tolist() == pytest.approx([5.0004, 1.0, 1.0, 6.3])
    for line, fed_mm in (("G1 X5.005 E6", 6.0), ("G1 X4.999 E-2", -2.0), ("G1 X5.3 E300", 300.0)):
        found = [i for i in items(*text[:-2], line) if isinstance(i, Moves | MoveAtRest)]
        _, fed, further = found
        assert isinstance(fed, MoveAtRest)
        assert isinstance(further, Moves)
        assert fed.end[3] - fed.start[3] == pytest.approx(fed_mm)
        assert further.points[0].tolist() == pytest.approx(list(fed.end))
        assert further.points[-1].tolist() == pytest.approx(
            [float(line.split()[1][1:]), 1, 1, 0.3 + fed_mm]
        )


@pytest.mark.parametrize("compiled", [True, False])
def test_a_move_without_a_path_is_ignored(monkeypatch: pytest.MonkeyPatch, compiled: bool) -> None:
    if not compiled:
        monkeypatch.setattr(batching, "plain_lines", one_by_one)
    text = (*HOME, "M83", "G1 X1", "G1 X1 Y0." + "0" * 170 + "1", "G5", "G1 X2", "G5 I0", "G1 X3")
    found = moves(*text, firmware="marlin")
    assert [block.points[:, 0].tolist() for block in found] == [[0.0, 1.0, 2.0, 3.0]]


def many(line: bytes, count: int) -> Iterator[bytes]:
    yield from (b"M83", b"G1 X1 Y1 Z1 F6000", b"G1 X5 E1", b"G1 X6 E1")
    yield from repeat(line, count)
    yield b"G1 X9 E1"


@pytest.mark.parametrize("line", few([b"M73 P5", b"; comment"], 1))
def test_endless_pass_through_lines_stop_the_machine_now_and_then(line: bytes) -> None:
    """So no stage has to keep all of them; the position stays known."""
    released, held, most = 0, 0, 0
    for item in read(many(line, 100_000), ReadOptions(KLIPPER)):
        if isinstance(item, Passthrough) and item.handling is Handling.RELEASE:
            released, held = released + 1, 0
        held += len(
            item.marks if isinstance(item, Moves) else item if isinstance(item, Marks) else [1]
        )
        most = max(most, held)
    assert 3 <= released < 30
    assert most * batching.BYTES_PER_MARK <= 1.1 * batching.MAX_MARK_BYTES
    assert isinstance(item, Passthrough)
    assert item.line == 100_005


def test_lines_longer_than_any_slicer_writes_are_refused() -> None:
    assert items(*HOME, ";" + "x" * (lines.MAX_LINE_BYTES - 1))
    with pytest.raises(GcodeError, match="line 4: a line of more than"):
        items(*HOME, ";" + "x" * lines.MAX_LINE_BYTES)


@pytest.mark.parametrize(
    ("text", "key"),
    [
        (("G28", "G1 X9999 Y9999"), "x"), (("T1", "G1 X-500"), "x"), (("G28", "G1 Z-20"), "z"),
        (("G92 X0 Y0 Z0", "G1 X5 Y-2 E1"), "y"), (("G92 X0 Y0 Z0", "G1 Z60"), "z"),
        (("G92 X0 Y0 Z0", "G2 X20 Y0 I10 J0"), ""), (("G92 X0 Y0 Z0", "G3 X20 Y0 I10 J0"), "y"),
        (("G92 X0 Y0 Z0", "G91", "G1 X-1"), "x"), (("G28", "G3 X50 Y500 I5 J5"), "y"),
    ],
)  # fmt: skip
def test_paths_beyond_the_bed_name_move_distance_and_key(text: tuple[str, ...], key: str) -> None:
    if not key:
        assert on_bed("M83", *text)
        return
    with pytest.raises(LimitError, match=rf"travel\.{key}") as caught:
        on_bed("M83", *text)
    assert caught.value.line == len(text) + 1
    assert text[-1] in str(caught.value)


def test_a_carriage_return_ends_a_line_for_marlin_only() -> None:
    """Marlin obeys a command that follows it in a comment."""
    text = [b"G92 X0 Y0 Z0", b"G1 X5 ; was\rG91\r\n", b"G1 X5"]
    ends = {}
    for name, firmware in FIRMWARES.items():
        found = list(read(text, ReadOptions(firmware.dialect)))
        ends[name] = [m.points[-1, 0] for m in found if isinstance(m, Moves)][-1]
    assert ends == {"klipper": 5, "marlin": 10}
    assert carried(found)[-1] == b"G91"


def filament(*text: str, extrusion: Extrusion | None = None) -> float:
    found = list(read([t.encode() for t in text], ReadOptions(KLIPPER, extrusion=extrusion)))
    return sum(float(i.points[-1, 3] - i.points[0, 3]) for i in found if isinstance(i, Moves))


START = ("PRINT_START BED=60", "G92 E0", "G1 X10 Y10 Z0.2 F6000")
EQUAL = [f"G1 X{20 + 10 * k} E1" for k in range(4)]
GROWING = [f"G1 X{20 + 10 * k} E{1 + k}" for k in range(4)]


def test_e_that_never_grows_after_a_macro_is_relative() -> None:
    assert filament(*START, *EQUAL) == 4.0
    varied = [f"G1 X{20 + 10 * k} Y{10 + 7 * (k % 3)} E{0.03 * (10 + k % 3):.4f}" for k in range(8)]
    assert filament(*START, *varied) == pytest.approx(0.03 * sum(10 + k % 3 for k in range(8)))


@pytest.mark.parametrize(
    "text", [(*START, "G1 X20 E1", "G1 X30 E1"), (*START[1:], *EQUAL)], ids=["few", "no macro"]
)
def test_unclear_e_needs_an_option(text: tuple[str, ...]) -> None:
    with pytest.raises(GcodeError, match="'hframe-post convert --extrusion absolute'"):
        filament(*text)
    e = float(sum(line.startswith("G1") and "E1" in line for line in text))
    assert filament(*text, extrusion="relative") == e
    assert filament(*text, extrusion="absolute") == 1.0


def test_a_macro_may_have_set_what_the_next_one_finds() -> None:
    """The mode of E at a release, before the file has a single E."""
    text = [*START, "G1 X12", "CHANGE_COLOUR", "G1 X14 Y10", *EQUAL]
    for first, absolute in ((START[0], False), ("G28", True)):
        found = read([t.encode() for t in (first, *text[1:])], ReadOptions(KLIPPER))
        [left] = [i for i in found if isinstance(i, Passthrough) and i.text == b"CHANGE_COLOUR"]
        assert left.state.absolute_e == absolute


PURGE = ("G92 E0", "G1 X0.1 Y20 Z0.3 F5000", "BED_MESH_CALIBRATE", "G1 Z0.3 F5000",
         "G1 X0.1 Y20 F5000", "G1 X0.1 Y200 F1500 E15", "G1 X0.4 Y20 F1500 E30")  # fmt: skip


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ((*START[:2], *PURGE), 30.0),  # two lines of one length
        ((*PURGE[:-1], "G1 X0.4 Y100 E18", "M82"), 18.0),
        ((*START[:2], *PURGE[:-1], "G1 X0.4 Y100 E18", "M82"), 18.0),  # by the mode that follows
        ((*START[1:], "Z_TILT_ADJUST", START[-1], *GROWING), 4.0),
    ],
)
def test_what_else_shows_that_e_is_absolute(text: tuple[str, ...], expected: float) -> None:
    assert filament(*text) == expected


@pytest.mark.parametrize(
    "own", ["BED_MESH_CALIBRATE", "SET_KINEMATIC_POSITION X=0 Y=0 Z=10", "L83", "M\x053"]
)
def test_commands_of_klippers_own_and_no_commands_set_no_mode(own: str) -> None:
    """A macro may; so what looks relative after these is asked for, not believed."""
    with pytest.raises(GcodeError, match="its numbers look relative"):
        filament(own, *START[1:], *EQUAL)
    assert filament("MY_OWN", *START[1:], *EQUAL) == 4.0


@pytest.mark.parametrize("words", ["S1", "P2 Q3", "S", "T0 R1.5 H1 D L"])
def test_words_that_firmware_ignores_in_moves_are_ignored(words: str) -> None:
    assert filament("G90", "M83", "G1 X10 Y10 Z.2 F6000", f"G1 X20 {words} E1") == 1.0
