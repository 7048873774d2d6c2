"""Inputs that are almost valid: slices, profiles and other texts with a few changes."""

import re
from functools import cache

from hypothesis import strategies as st

from tests.conftest import ROOT, SAMPLES

NUMBER = re.compile(rb"[-+]?\d+\.?\d*(?:[eE][-+]?\d+)?")
NUMBERS = (
    b"0", b"-0", b"1e9", b"-1", b"0.00001", b"999999", b"-3.5", b"nan", b"inf", b"1e400", b"1.",
    b".5", b"+2", b"--3", b"1.2.3", b"0x10", b"9" * 400, b"1" * 5000, b"", b"1e-300", b"0.0349",
    b"1,5", b"00010", b"+.5", b"-.0", b".", b"-", b"1_0", b"1e3", b" 7", b"279.999", b"280.001",
    b"0.0005", b"2147483648", b"4294967297", b"1.0000000000000000001", "\uff11".encode(),
    b"1e14", b"20000", b"true", b"'a'", b"[]", b"[1]", b"{}", b"1979-05-27",
)  # fmt: skip
LINES = (
    # modes and places
    b"G91", b"G90", b"M82", b"M83", b"G92 E0", b"G92 X10 Y10", b"G92", b"G92 Z0.2", b"G92 E0 X5",
    b"G92.1", b"G20", b"G21", b"G28", b"G28 X", b"G28 W", b"G 91", b"M 82", b"(c) G91", b"N 5 G91",
    b"G90 G91", b"G17", b"G18", b"G53 G1 X1", b"G54", b"G1 X100;G91", b"M206 X1", b"G60 S0",
    b"SAVE_GCODE_STATE NAME=x", b"RESTORE_GCODE_STATE NAME=x MOVE=1", b"SET_GCODE_OFFSET Z=0.1",
    b"M120", b"M121", b"SET_KINEMATIC_POSITION X=1",
    # moves
    b"G1 F0.01", b"G1 F0", b"G1 F-600", b"G1", b"G1 X", b"G1 X9999", b"G1 Z-20", b"G1 Z100 F1",
    b"G1 E219414", b"G1 E-5 F2400", b"G1 E5 F2400", b"G1 Z0.4 F600", b"G0 X100 Y100 F9000",
    b"G1 X100.0001 Y100 E0.0001", b"G1X101Y101F3000", b"g1x102y99e.1", b"n7 g1 x101 y101*99",
    b"G1 X100 Y100 ; (", b"G1 X100 (a ; b) Y100", b"G1 A5", b"G1 X100 X101", b"G1 X1e2 Y1e2",
    b"G01 X100 Y100", b"G1.0 X100", b"G1 X100 Y100 E.5 H1", b"G0 E1", b"G1 P1 X99", b"G1 S1 X99",
    # curves
    b"G2 X110 Y100 I5 J0 E1", b"G3 I10 J0 E2", b"G2 X90 Y100 R5", b"G3 X95 Y100 R-20 E1",
    b"G3 I50000", b"G2 I5 P3 E2", b"G3 X100 Y100 I0 J0", b"G2 X100 Y100 R0", b"G3 I5 J5 Z1 E1",
    b"G2 I1 K2", b"G5 I1 J1 P1 Q1 X120 Y120", b"G2 X100 Y100 I1e-9", b"G3 I3 P1.5",
    # waiting, temperatures, tools, filament
    b"M104 S200", b"M109 S200", b"G4 P500", b"G4 S1", b"G4 P-5000", b"G4 P1e9", b"G4", b"G4 P",
    b"T1", b"T0", b"T", b"T?", b"T-1", b"T255", b"M600", b"G10", b"G11", b"G10 S1", b"G10 P0 X1",
    b"M84", b"M18 E", b"M400", b"M25", b"M0", b"M2", b"M112", b"PAUSE", b"M221 S90", b"M220 S50",
    b"M220 S0", b"M220 B", b"M220 R", b"M220 S1000", b"M200 D1.75", b"M900 K0.05",
    # limits
    b"M204 S500", b"M204 S0.0000001", b"M204 P800 T900", b"M201 X500 Y500", b"M203 Y0.001",
    b"M203 X200 Y200", b"M205 X8", b"M205 J0.01", b"M566 X300 Y300", b"M593 F40",
    b"SET_VELOCITY_LIMIT ACCEL=1e4", b"SET_VELOCITY_LIMIT VELOCITY='20'",
    b"SET_VELOCITY_LIMIT accel=900 # x", b"SET_VELOCITY_LIMIT ACCEL", b"SET_PRESSURE_ADVANCE X",
    # what is commanded, and to whom
    b"M73 P10 R5", b"M73 P10.5 R7.5 Q3 S1", b"M117 Layer 3 *5", b"M117 G91", b"M118 E1 G28",
    b"M106 S255", b"M486 S1", b"M486 APart", b";TIME:100", b"; G91", b";TIME_ELAPSED:5.5",
    b"; estimated printing time (normal mode) = 1h 2m 3s", b";LAYER:7", b";TYPE:WALL-OUTER",
    b"EXCLUDE_OBJECT_START NAME='a (1)'", b"EXCLUDE_OBJECT_END", b"PRINT_START A=1 B='x y'",
    b"; printing object Cube id:0 copy 0", b"M624 AQAAAAAAAAA=", b"M625", b"G29", b"G380 S2 Z1",
    b"{if layer_z > 1}G91{endif}", b"; thumbnail begin 2x2 8", b"_MACRO", b"UNHEARD_OF",
    # what is not a line
    b"\xff\xfe\x00", b"(" * 50, b"\x1b[2J", b"%", b"\x00", b"*", b"N10", b"N10*20", b"O1000",
    b"/G1 X1", b"#1=5", b"?", b"$$", b"\xe2\x80\xa8G91", b"G1 X100\x0bY100", b"G\xa091",
    b"G1\tX100", b";" + b"x" * 100_000, b"G1 X100" + b" " * 70_000, b"\xef\xbb\xbfG91", b"a\rG91",
)  # fmt: skip
STRETCH = 60  # lines of a slice
HEAD = b"G28\nG90\nM83\nG1 X100 Y100 Z0.2 F6000\n"
words = st.builds(
    lambda letter, value: b" %c%.4g" % (letter, value),
    st.sampled_from(b"XYZEFIJRPS"), st.floats(-5.0, 250.0),
)  # fmt: skip
built = st.builds(
    lambda head, rest: head + b"".join(rest),
    st.sampled_from((b"G1", b"G1", b"G0", b"G2", b"G3", b"G92", b"M204", b"M203", b"G4", b"G10")),
    st.lists(words, max_size=5),
)
lines = st.one_of(st.sampled_from(LINES), built)


@cache
def slices() -> list[list[bytes]]:
    """Return the lines of all G-code files among the samples and oddities."""
    folders = (SAMPLES, ROOT / "tests" / "quirks")
    paths = [path for folder in folders for path in sorted(folder.glob("*.gcode"))]
    return [path.read_bytes().splitlines()[:20_000] for path in paths]


def _edited(rows: list[bytes], edits: list[tuple[int, int, bytes, bytes]]) -> bytes:
    """Return the text after edits: which line, what is done, an odd number, another line."""
    rows = list(rows)
    for where, what, number, line in edits:
        k = where % len(rows) if rows else 0
        found = list(NUMBER.finditer(rows[k])) if rows else []
        if what <= 1 or not rows:
            rows.insert(k, line)
        elif what <= 3 and found:
            place = found[where % len(found)]
            rows[k] = rows[k][: place.start()] + number + rows[k][place.end() :]
        elif what == 4:
            del rows[k : k + 1 + where % 3]
        elif what == 5:
            rows.insert(k, rows[where // 7 % len(rows)])
        elif what == 6:
            rows[k : k + 2] = [b"".join(rows[k : k + 2])]
        else:
            at = where // 11 % (len(rows[k]) + 1)
            rows[k] = rows[k][:at] + line[:1] + rows[k][at + 1 :]
    return b"\n".join(rows)


def edited(
    text: bytes | list[bytes], line: st.SearchStrategy[bytes] = lines
) -> st.SearchStrategy[bytes]:
    """Return texts with a few lines added, lost, doubled, joined, and numbers made odd."""
    rows = text.splitlines() if isinstance(text, bytes) else text
    edit = st.tuples(st.integers(0, 1 << 20), st.integers(0, 7), st.sampled_from(NUMBERS), lines)
    return st.lists(edit, min_size=1, max_size=12).map(lambda edits: _edited(rows, edits))


@st.composite
def gcode(draw: st.DrawFn) -> bytes:
    """Draw a part of a slice, begun as a print is or not, with a few changes."""
    rows = draw(st.sampled_from(slices()))
    at = draw(st.integers(0, max(len(rows) - STRETCH, 0)))
    text = draw(edited(rows[at : at + STRETCH]))
    end = draw(st.sampled_from((b"\n", b"", b"\r\n")))
    return draw(st.sampled_from((HEAD, HEAD, b""))) + text.replace(b"\n", end or b"\n") + end


def broken(data: bytes) -> st.SearchStrategy[bytes]:
    """Return data with a few pieces overwritten, lost or doubled, or without its end."""
    edit = st.tuples(
        st.integers(0, len(data)), st.integers(0, 3), st.binary(min_size=1, max_size=40)
    )

    def change(edits: list[tuple[int, int, bytes]]) -> bytes:
        new = data
        for at, what, piece in edits:
            size = len(piece)
            new = (
                new[:at] + piece + new[at + size :], new[:at] + new[at + size :],
                new[:at] + new[at : at + 50 * size] + new[at:], new[: max(at, 1)],
            )[what]  # fmt: skip
        return new

    return st.lists(edit, min_size=1, max_size=6).map(change)
