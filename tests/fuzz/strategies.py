"""Inputs that are almost valid: slices, profiles and other texts with a few changes."""

import re
from functools import cache
from pathlib import Path

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
ODD = Path(__file__).with_name("lines.txt").read_text().splitlines()
LINES = (
    *(line.encode().decode("unicode_escape").encode("latin-1") for line in ODD),
    b";" + b"x" * 100_000, b"G1 X100" + b" " * 70_000,
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
