"""pygcode as the oracle of plain geometric lines: G0, G1, G2, G3 and G92.

pygcode (https://pypi.org/project/pygcode) reads words as we do, but it refuses a plus sign. Its
``Machine`` follows X, Y and Z in absolute and relative coordinates, in the units of the file; it
has no E and gives G92 another meaning, so those are compared as words only. Where the moves of
whole files end, Klipper's own reader tells (tests/klipper/test_defaults.py); it knows no inches.
"""

import re
from collections import Counter
from pathlib import Path

import pytest
from pygcode import Line as PygcodeLine
from pygcode import Machine
from pygcode.words import text2words

from hframe_post.firmware.registry import FIRMWARES
from hframe_post.gcode.commands import MOTION_WORDS, Line, command, numbers, uncommented
from hframe_post.gcode.state import ReadOptions
from tests.conftest import SAMPLES
from tests.gcode.reading import ends_by_line
from tests.slices import SLICES

KLIPPER = FIRMWARES["klipper"].dialect

QUIRKS = Path(__file__).parent.parent / "quirks"
NAMES = ("G0", "G1", "G2", "G3", "G92")
FILES = {
    **{path.name: path.read_bytes() for folder in (SAMPLES, QUIRKS) for path in folder.glob("*")},
    **{name: b"".join(each.lines) for name, each in SLICES.items()},
}


def geometric_lines(text: bytes) -> list[tuple[Line, str, bytes]]:
    """Return the lines of a file that are G0, G1, G2, G3 or G92: line, name, arguments."""
    found = []
    for number, raw in enumerate(text.splitlines(), 1):
        line = Line(number, raw.removeprefix(b"\xef\xbb\xbf"))
        # a line number would be a word of its own, and a checksum is no G-code to pygcode
        if line.text[:1] not in b"Nn" and (coded := command(line)) and coded.name in NAMES:
            found.append((line, *coded))
    return found


@pytest.mark.parametrize("name", FILES)
def test_pygcode_reads_the_same_words(name: str) -> None:
    """At most twenty lines of every form, such as ``G1 X9.999 E.99``."""
    forms: Counter[bytes] = Counter()
    for line, code, arguments in geometric_lines(FILES[name]):
        text = uncommented(line.text).strip()
        form = re.sub(rb"\d+", b"9", text)
        forms[form] += 1
        if forms[form] > 20:
            continue
        words = text2words(text.replace(b"+", b"").decode())
        assert f"G{next(words).value:g}" == code
        # P of an arc is read, and ignored as firmwares do
        expected = {word.letter: word.value for word in words if word.letter != "P"}
        assert numbers(line, arguments, MOTION_WORDS[code] + "F") == expected


@pytest.mark.parametrize("unit", ["G20", "G21"])
def test_moves_end_where_pygcode_ends(unit: str) -> None:
    plain = (
        uncommented(raw).upper().replace(b"+", b"") for raw in FILES["by_hand.gcode"].splitlines()
    )
    lines = [re.sub(rb"\s*E\s*[-.\d]+", b"", line).strip() for line in plain if b"G92" not in line]
    lines = [b"G1 F3000", *lines]
    ends = ends_by_line([b"G92 X0 Y0 Z0", unit.encode(), *lines], ReadOptions(KLIPPER))
    machine, scale = Machine(), 25.4 if unit == "G20" else 1.0
    for number, line in enumerate(lines, 3):
        machine.process_block(PygcodeLine(line.decode()).block)
        if number in ends:
            expected = [scale * getattr(machine.pos, axis) for axis in "XYZ"]
            assert ends[number] == pytest.approx(expected, abs=1e-9), line
    assert len(ends) > 5
