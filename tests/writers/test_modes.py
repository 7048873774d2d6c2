"""Modes of the stream: a file's own mode commands do not outlast their line, however spelled."""

import pytest

from hframe_post.conversion.conversions import GcodeConversion
from hframe_post.conversion.options import Options
from hframe_post.printer.profile import load
from tests.gcode_tools import follow

SPELLINGS = {
    "G91": ["G91", "G 91", "g91", "(c) G91", "N 5 G91", "N5 G91", "G091", " G91 ; (d)"],
    "M82": ["M82", "M 82", "m082", "(c)M82", "N 6M82"],
}


@pytest.mark.parametrize(
    ("spelling", "profile"),
    [
        (text, ("paper", "paper-marlin")[k % 2])
        for texts in SPELLINGS.values()
        for k, text in enumerate(texts)
    ],
)
def test_reader_and_writer_read_modes_alike(profile: str, spelling: str) -> None:
    name = next(name for name, texts in SPELLINGS.items() if spelling in texts)
    lines = [
        b"G90\n", b"M83\n", b"G1 X50 Y50 Z1 F6000\n", b"G1 X60 E.5\n", spelling.encode() + b"\n",
        b"G1 X80 E.7\n" if name == "M82" else b"G1 X20 E.2\n", b"G90\n", b"M83\n",
        b"G1 X90 E.1\n",
    ]  # fmt: skip
    printer = load(profile)
    text = b"".join(
        piece for piece in GcodeConversion(lines, printer, Options("none"))
        if isinstance(piece, bytes)
    )  # fmt: skip
    written = text.splitlines()
    following = written[written.index(spelling.encode()) + 1 :][:2]
    assert (b"G90" if name == "G91" else b"M83") in following
    reading = follow(text.replace(spelling.encode(), name.encode()))
    assert reading.points[-1][0] == pytest.approx(90.0, abs=0.02)
